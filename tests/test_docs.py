"""What the documents name is there: files, links, tests, and the command lines that they show."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from clsss import cli, options, view

ROOT = Path(__file__).parent.parent
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
EACH = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
TESTS = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").glob("*.py"))


@EACH
def test_links_lead_somewhere(document):
    text = document.read_text(encoding="utf-8")
    titles = re.findall(r"^#+ (.+)$", text, re.M)
    anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", text):
        assert not target or "://" in target or (document.parent / target).exists(), target
        assert target or anchor in anchors, anchor


@EACH
def test_files_and_tests_that_are_named_exist(document):
    text = document.read_text(encoding="utf-8")
    for path in re.findall(r"\b((?:apps|clsss|docs|kernels|scripts|tests)/[\w/.-]+\.(?:py|md|cl|h|sh))\b", text):
        assert (ROOT / path).exists(), path
    for name in re.findall(r"\b(test_\w+)(?!\w*\.py)", text):
        assert f"def {name}" in TESTS or (ROOT / "tests" / f"{name}.py").exists(), name


def commands():
    """Every `clsss` and `python -m clsss.view` that a document shows, as words."""
    for document in DOCUMENTS:
        for line in re.findall(r"^ *((?:clsss|python -m clsss\.view) .*)$", document.read_text(encoding="utf-8"), re.M):
            words = shlex.split(line, comments=True)
            if not {"opens", "MESH"} & set(words):
                yield " ".join(words)


@pytest.mark.parametrize("line", sorted(set(commands())))
def test_commands_that_are_shown_parse(line):
    words = line.split()
    parser, words = (cli._parser(), words[1:]) if words[0] == "clsss" else (view._parser(), words[3:])
    assert options.parse(parser, words)


def test_every_option_is_told_of():
    """In the README, all that a scene file takes and what the window has besides."""
    text = DOCUMENTS[0].read_text(encoding="utf-8")
    parser = view._parser()
    options.add_output(parser)
    told = [option for action in parser._actions for option in action.option_strings if option.startswith("--")]
    assert [option for option in told if option not in text] == ["--help", "--output"]
