"""The pages of the project: links lead somewhere, and what they name exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fg_gcs.experiment import flights, formulations, moving_targets, multi, results, sensitivity, table1, times

ROOT = Path(__file__).parent.parent
PAGES = [
    ROOT / "README.md",
    ROOT / "missions/README.md",
    ROOT / "logs/README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
DECISIONS = ROOT / "docs" / "decisions"
MADE_BY_RUNS = "logs/"  # folders of runs; their names are those of an example
TYPED_BY_USERS = re.compile(r"^(/|~|\.venv/|logs/<)|[<>*{}$ ]")  # commands and placeholders, not paths of the project
# Named by the pages, and made beside them; an entry goes as soon as its file is there
NETWORK = ("http://", "https://", "mailto:")


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def prose(page: Path) -> str:
    """Return a page without its blocks of code."""
    return re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_relative_links_lead_to_files_and_headings(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if link.startswith(NETWORK):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_paths_in_backticks_exist(page: Path) -> None:
    for quoted in re.findall(r"`([^`\n]+)`", prose(page)):
        if "/" not in quoted or TYPED_BY_USERS.search(quoted) or quoted.startswith(MADE_BY_RUNS):
            continue
        if re.fullmatch(r"[\w./-]+(\.(py|md|toml|csv)|/)", quoted):
            found = any((ROOT / room / quoted).exists() for room in ("", "fg_gcs", "docs", "tests"))
            assert found, quoted


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_formulas_end_where_they_begin(page: Path) -> None:
    """Inline mathematics stays within a line: else it is not recognised, and neither is what comes after it."""
    outside = re.sub(r"\$\$.*?\$\$", "", re.sub(r"`[^`\n]*`", "", prose(page)), flags=re.DOTALL)
    assert "$$" not in outside
    for line in outside.splitlines():
        assert line.count("$") % 2 == 0, line


def test_every_cited_paper_is_listed() -> None:
    listed = set(re.findall(r"^\| \[(\w+)\]", (ROOT / "docs/references.md").read_text(), re.MULTILINE))
    assert len(listed) > 10
    for page in PAGES:
        assert set(re.findall(r"\[([A-Z]\w+\d{4})\]", prose(page))) <= listed, name(page)
    for source in (ROOT / "fg_gcs").rglob("*.py"):
        assert set(re.findall(r"\[(\w+)\]_", source.read_text())) <= listed, name(source)


def test_the_page_on_architecture_lists_every_room() -> None:
    page = (ROOT / "docs/architecture.md").read_text()
    for package in (ROOT / "fg_gcs", ROOT / "sitl_mock"):
        for init in package.rglob("__init__.py"):
            room = init.parent.relative_to(ROOT).as_posix()
            assert init.parent == package or f"{room.removeprefix('fg_gcs/')}/" in page, room


def test_decisions_are_numbered_dated_and_listed() -> None:
    index = (DECISIONS / "README.md").read_text()
    records = sorted(path for path in DECISIONS.glob("*.md") if path.name != "README.md")
    assert len(re.findall(r"^\| \[\d", index, re.MULTILINE)) == len(records)
    for number, record in enumerate(records, start=1):
        text = record.read_text()
        heading = re.match(rf"# {number}\. (.+)\n\n(\d{{4}}-\d\d-\d\d)\n\n\*\*Context\.\*\* ", text)
        assert heading is not None, record.name
        assert f"| [{number:04d}]({record.name}) | {heading[2]} | {heading[1]} |" in index
        assert "**Decision.** " in text
        assert "**Consequence.** " in text


def test_the_results_page_says_what_the_experiments_say() -> None:
    page = (ROOT / "docs/results.md").read_text()
    assert page.startswith(results.HEADING)
    assert all(module.TEXT in page for module in (table1, times, flights, multi, moving_targets, formulations))
    assert all(text in page for text in (moving_targets.REPLANS_TEXT, sensitivity.SUMMARY_TEXT, sensitivity.ROWS_TEXT))
