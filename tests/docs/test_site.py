"""The built documentation: no warnings, nothing from the network, and a search that works from disk."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import needs_browser
from tests.support.commands import python

WIDE = "() => document.documentElement.scrollWidth - innerWidth"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    options = ("--strict", "--quiet", "--site-dir", folder)
    python("-m", "mkdocs", "build", *options, NO_MKDOCS_2_WARNING="1")
    return folder


def test_site__fetches_nothing_from_the_network(site: Path) -> None:
    for page in site.glob("*.html"):
        fetched = re.findall(r"<(?:script|link|img|iframe)\b[^>]*", page.read_text("utf-8"))
        assert not [tag for tag in fetched if re.search(r"(?:src|href)=\"?https?:", tag)], page.name


def test_site__has_the_tables_that_are_made_from_the_code(site: Path) -> None:
    assert "limit_tolerance" in (site / "robots.html").read_text("utf-8")
    assert "32,647" in (site / "robots.html").read_text("utf-8")
    assert "<!-- shipped -->" not in (site / "policies.html").read_text("utf-8")
    assert "support_margin" in (site / "environment.html").read_text("utf-8")
    assert "snake_env.sb3" in (site / "api.html").read_text("utf-8")


@needs_browser
def test_search__works_from_disk(site: Path, browser: Any) -> None:
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.goto((site / "index.html").as_uri())
    page.click(".md-search__input")
    page.keyboard.type("shield", delay=20)
    page.wait_for_selector(".md-search-result__item")
    assert "Policies" in page.inner_text(".md-search-result__list")
    page.close()


@needs_browser
@pytest.mark.parametrize("width", [1400, 390])
def test_pages__do_not_scroll_sideways(site: Path, browser: Any, width: int) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900})
    for file in sorted(site.glob("*.html")):
        page.goto(file.as_uri())
        assert page.evaluate(WIDE) <= 0, file.name
    page.close()
