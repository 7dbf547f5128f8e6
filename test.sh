#!/usr/bin/env bash
# Sets up what is missing, then checks style and types and runs the tests; arguments go to pytest.
#
#   ./test.sh             what every change must pass
#   ./test.sh -m ''       the slow tests too
set -euo pipefail
cd -- "$(dirname -- "${BASH_SOURCE[0]}")"
# shellcheck source=scripts/setup.sh
source scripts/setup.sh
setup '.[test]'
status=0
.venv/bin/python -m ruff check . || status=1
.venv/bin/python -m mypy || status=1
.venv/bin/python -m pytest -q "$@" || status=1
exit "$status"
