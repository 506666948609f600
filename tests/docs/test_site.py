"""Build the documentation site as `scripts/docs` does: warnings are errors, and pages load nothing from other hosts."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from tests.integration.viewer.browsing import CHROMIUM, FLAGS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BUILD = ["-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet", "--builder", "html"]
TAGS = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "object": "data"}


class Fetched(HTMLParser):
    """Collect the addresses that a browser fetches for a page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value for name, value in attrs if TAGS.get(tag) == name and value]


def build(source: Path, site: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *BUILD, str(source), str(site)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = build(DOCS, folder)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_is_built(site: Path) -> None:
    pages = [page.relative_to(DOCS).with_suffix(".html") for page in DOCS.rglob("*.md")]
    assert len(pages) > 30
    assert [page for page in pages if not (site / page).exists()] == []


def test_sidebar_lists_all_pages_by_their_titles(site: Path) -> None:
    page = (site / "start.html").read_text(encoding="utf-8")
    sidebar = page[page.index('<div class="sidebar-tree">') :]
    links = re.findall(r'<a class="[^"]*reference internal" href="([^"]+)"', sidebar[: sidebar.index("</aside>")])
    pages = {path.relative_to(DOCS).with_suffix(".html").as_posix() for path in DOCS.rglob("decisions/0*.md")}
    assert len(pages) > 40
    assert pages <= set(links)
    # Links to sections of pages do not belong in the sidebar.
    assert [link for link in links if re.search(r"#.", link)] == []


def test_notebook_is_executed_and_filter_is_consistent(site: Path) -> None:
    page = (site / "notebook" / "localize.html").read_text(encoding="utf-8")
    assert len(re.findall(r'<img alt="[^"]*" src="[^"]+\.png"', page)) == 2
    text = html.unescape(re.sub(r"<[^>]+>", "", page))
    assert re.search(r"2 of 2 waypoints reached", text)
    pattern = r"mate is ([\d.]+) in off .*?alone is ([\d.]+) in off.*?mean NEES ([\d.]+);"
    (numbers,) = re.findall(pattern, text, re.DOTALL)
    # 0.6 in separates the estimate from odometry alone; the mean NEES of a consistent filter is 3.
    estimate_in, odometry_in, nees = map(float, numbers)
    assert estimate_in < 0.6 < odometry_in
    assert 1.0 < nees < 6.0


@pytest.mark.long
def test_formulas_are_typeset_without_network(site: Path) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page()
        for name, count in (("localization", 15), ("methods", 2), ("mapping", 20)):
            page.goto((site / f"{name}.html").as_uri())
            page.wait_for_function(f"document.querySelectorAll('mjx-container').length >= {count}")
            # What is left of LaTeX in the text of the page, code aside.
            page.evaluate("document.querySelectorAll('pre, code').forEach((one) => one.remove())")
            assert re.findall(r"\\[a-z]+|\$[^$]*\$", page.inner_text("body")) == []
        browser.close()


def test_nothing_is_loaded_from_other_hosts(site: Path) -> None:
    # A page without any style would pass the next assertion.
    fetched = {address for page in site.rglob("*.html") for address in Fetched(page).addresses}
    assert any(".css" in address for address in fetched)
    assert [address for address in fetched if re.match(r"(\w+:)?//", address)] == []
    styles = "".join(style.read_text(encoding="utf-8") for style in site.rglob("*.css"))
    assert re.findall(r"""(?:@import\s+|url\()\s*["']?(?:\w+:)?//[^)\s]*""", styles) == []


# A control for --fail-on-warning.
def test_a_dead_link_is_an_error(tmp_path: Path) -> None:
    source = tmp_path / "docs"
    source.mkdir()
    (source / "conf.py").write_text((DOCS / "conf.py").read_text())
    (source / "index.md").write_text("# A page\n\n[nowhere](nowhere.md)\n")
    done = build(source, tmp_path / "site")
    assert done.returncode == 1
    assert "nowhere.md" in done.stderr


def test_script_builds_with_the_same_options() -> None:
    assert f"python {' '.join(BUILD)} docs" in (ROOT / "scripts" / "docs").read_text()
