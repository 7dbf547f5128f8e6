"""`python -m clsss` is the `clsss` command."""

from clsss.cli import main

main()
