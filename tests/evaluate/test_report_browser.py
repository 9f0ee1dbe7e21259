"""The report in a browser: a Chromium of the machine's own, driven by playwright."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluate.report import write_report
from evaluate.report.motion import encode, motion_of
from snake_env.rendering.drawing import convex_hull, geometry
from tests.support import ROOT
from tests.support.browser import needs_browser
from tests.support.evaluations import SUITE, rows_of, summary_of
from tests.support.robots import PAPER, random_state

POLICIES = ("analytic", "imitate", "random", "skid")
TIME = "() => Number(document.querySelector('#scrub').value)"
PIXELS = "side => document.querySelector(`[data-side=${side}] canvas`).toDataURL()"

pytestmark = needs_browser


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = {policy: rows_of(policy) for policy in POLICIES}
    folder = tmp_path_factory.mktemp("report")
    return write_report(folder, POLICIES, rows, summary_of(rows), PAPER, SUITE)


class Opened:
    """A page in the browser, and what it complained of or asked for."""

    def __init__(self, page: Any, report: Path) -> None:
        self.complaints: list[str] = []
        self.requests: list[str] = []
        page.on("console", lambda message: self.complaints.append(message.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(report.as_uri())
        self.page = page

    def time(self) -> float:
        """What the clock shows [s]."""
        return float(self.page.evaluate(TIME))

    def pixels(self, side: str = "left") -> str:
        """The robot's picture."""
        return str(self.page.evaluate(PIXELS, side))

    def press(self, *keys: str) -> None:
        """Presses keys while the player has the focus."""
        self.page.focus("#player")
        for key in keys:
            self.page.keyboard.press(key)


@contextmanager
def with_scripts(browser: Any, *names: str) -> Iterator[Any]:
    """An empty page with scripts of the report."""
    with browser.new_context() as context:
        page = context.new_page()
        for name in names:
            page.add_script_tag(content=(ROOT / "evaluate" / "report" / name).read_text())
        yield page


@pytest.fixture
def opened(browser: Any, report: Path) -> Iterator[Opened]:
    """The report on a desk, in light colours, for a reader who wants no motion."""
    with browser.new_context(
        viewport={"width": 1280, "height": 900}, color_scheme="light", reduced_motion="reduce"
    ) as context:
        opened = Opened(context.new_page(), report)
        yield opened
        assert opened.complaints == []


def test_page__asks_for_nothing(opened: Opened, report: Path) -> None:
    page = opened.page
    page.mouse.wheel(0, 20_000)
    opened.press("n", "End", " ")
    page.wait_for_timeout(200)
    assert {url for url in opened.requests if not url.startswith("data:")} == {report.as_uri()}
    assert "evaluation of 4 policies" in page.title()


def test_scrubber__moves_the_robot(opened: Opened) -> None:
    before, target = opened.pixels(), opened.pixels("right")
    opened.page.fill("#scrub", "20")
    assert opened.time() == 20
    assert opened.pixels() != before
    assert opened.pixels("right") != target
    assert opened.page.inner_text("#time").startswith("20.0 / ")
    assert re.match(
        r"phase \d, mode \d+, wheels lifted: \d", opened.page.inner_text(".status >> nth=0")
    )
    opened.page.fill("#scrub", "0")
    assert opened.pixels() == before


def test_keys__move_the_clock(opened: Opened) -> None:
    end = float(opened.page.get_attribute("#scrub", "max"))
    opened.press("ArrowRight", "ArrowRight", "ArrowRight", "ArrowLeft")
    assert opened.time() == pytest.approx(2.0)
    opened.press("End")
    assert opened.time() == pytest.approx(end)
    assert "target reached" in opened.page.inner_text("[data-side=left] .outcome")
    opened.press("ArrowRight")
    assert opened.time() == pytest.approx(end)
    opened.press("Home")
    assert opened.time() == 0
    speeds = []
    for key in ("+", "+", "+", "-", "-", "-", "-", "-"):
        opened.press(key)
        speeds.append(opened.page.eval_on_selector("#speed", "list => list.value"))
    assert speeds == ["8", "8", "8", "4", "2", "1", "0.5", "0.5"]


def test_space__plays_and_pauses(opened: Opened) -> None:
    page = opened.page
    assert page.get_attribute("#play", "aria-label") == "Play"
    opened.press("Home", " ")
    page.wait_for_function("() => Number(document.querySelector('#scrub').value) > 0.5")
    assert page.get_attribute("#play", "aria-label") == "Pause"
    opened.press(" ")
    stopped = opened.time()
    page.wait_for_timeout(300)
    assert opened.time() == stopped > 0.5
    page.focus("#play")  # the button keeps its own space: it must not count twice
    page.keyboard.press(" ")
    page.wait_for_function(f"() => Number(document.querySelector('#scrub').value) > {stopped}")
    opened.press("End")
    page.wait_for_function("() => !document.querySelector('#play').matches('.playing')")
    opened.press(" ")  # from the end it starts again
    page.wait_for_function(f"() => {TIME[6:]} < 20")


def test_episodes__are_switched(opened: Opened) -> None:
    page = opened.page
    names = page.eval_on_selector_all("#episode option", "all => all.map(one => one.text)")
    groups = page.eval_on_selector_all("#episode optgroup", "all => all.map(one => one.label)")
    assert names[0] == "sim-1: simulation 1 of the paper, not among these tasks"
    assert groups[0] == "Typical"
    shown = [page.eval_on_selector("#episode", "list => list.selectedIndex")]
    before = opened.pixels()
    opened.press("ArrowRight")
    page.click("#next")
    assert opened.time() == 0
    assert opened.pixels() != before
    for action in ("n", "p", "p"):
        opened.press(action)
        shown.append(page.eval_on_selector("#episode", "list => list.selectedIndex"))
    assert shown == [0, 2, 1, 0]
    page.click("#previous")  # round the corner
    assert page.eval_on_selector("#episode", "list => list.selectedIndex") == len(names) - 1
    page.select_option("#episode", index=0)
    assert opened.pixels() == before


def test_policies__are_chosen_for_each_side(opened: Opened) -> None:
    page = opened.page
    opened.press(*["ArrowRight"] * 2)
    page.select_option("#left", "0")
    page.select_option("#right", "0")
    assert opened.pixels("left") == opened.pixels("right")
    page.select_option("#right", "3")
    assert opened.time() == pytest.approx(2.0)  # the clock goes on
    assert opened.pixels("left") != opened.pixels("right")
    assert page.inner_text("[data-side=right] .status") == "all joints turn at once"
    assert page.inner_text("[data-side=left] .status").startswith("phase 1, mode")


def test_charts__seek_where_they_are_clicked(opened: Opened) -> None:
    page = opened.page
    box = page.locator("[data-traces=left] canvas").bounding_box()
    end = float(page.get_attribute("#scrub", "max"))
    left, right = 42, 8  # what the charts leave free
    half = left + (box["width"] - left - right) / 2
    page.locator("[data-traces=left] canvas").click(position={"x": half, "y": 150})
    assert opened.time() == pytest.approx(end / 2, abs=0.2)
    cursors = page.eval_on_selector_all(
        ".cursor",
        "all => all.map(one => one.getBoundingClientRect().x"
        " - one.parentNode.getBoundingClientRect().x)",
    )
    assert cursors == pytest.approx([half, half], abs=1.5)


def test_failures__lead_to_their_replays(opened: Opened) -> None:
    page = opened.page
    link = page.locator("#failures [data-replay]").first
    name = link.get_attribute("data-replay")
    link.click()
    chosen = page.eval_on_selector("#episode", "list => list.selectedOptions[0].text")
    assert chosen.startswith(f"{name}: ")
    assert page.evaluate("document.activeElement.id") == "player"


def test_failures__are_shown_from_shortly_before_the_violation(opened: Opened) -> None:
    page = opened.page
    words = {
        "stability": r"tipped over: the centre of gravity left the support polygon in phase \d, ",
        "joint limit": r"joint \d passed its limit in phase \d, ",
    }
    seen = set()
    texts = page.eval_on_selector_all("#episode option", "all => all.map(one => one.text)")
    for index, text in enumerate(texts):
        cause = next((cause for cause in words if f"random: {cause} in phase" in text), None)
        if cause is None:
            continue
        page.select_option("#episode", index=index)
        page.select_option("#left", "2")
        ending = page.inner_text("[data-side=left] .outcome")
        assert re.match(words[cause], ending)
        end = float(ending.split()[-2])
        begun = opened.time()
        assert page.eval_on_selector("#left", "list => list.value") == "2"
        assert begun == pytest.approx(max(0.0, end - 6.0), abs=0.11)
        before = opened.pixels()
        page.fill("#scrub", str(end + 0.1))
        assert opened.pixels() != before
        seen.add(cause)
    assert "stability" in seen


def test_endings__name_the_joint_and_when_the_robot_stopped(browser: Any) -> None:
    call = """run => {
      const robot = { delta_t: 3 };
      const whole = { phases: [1, 1, 2], lastPhase: 2, at: () => ({ phi: run.phi }), ...run };
      return Player.prototype.outcome.call({ robot }, whole);
    }"""
    cases = {
        "joint 3 passed its limit in phase 2": ("joint_limit", [0.1, -0.2, -1.6, 1.5], 7.3, 7.3),
        "deadlock in phase 2: nothing moves after 30 s": ("deadlock", [0.0], 33.0, 300.0),
        "deadlock in phase 2": ("deadlock", [0.0], 33.0, 33.0),
        "out of time in phase 2": ("horizon", [0.0], 300.0, 300.0),
        "links touched in phase 2": ("collision", [0.0], 5.0, 5.1),
    }
    with with_scripts(browser, "robot.js", "player.js") as page:
        for words, (outcome, phi, end, time) in cases.items():
            run = {"outcome": outcome, "phi": phi, "end": end, "time": time, "solved": False}
            assert page.evaluate(call, run) == words


def test_centre_of_gravity__is_red_where_nothing_supports_it(browser: Any) -> None:
    robot = {"n_joints": 8, "l": PAPER.l, "track": PAPER.track, "head_contact": True}
    robot |= {"phi_limit": PAPER.phi_limit, "w_d": list(PAPER.w_d)}
    call = """([robot, lifted, tips]) => {
      const canvas = document.body.appendChild(document.createElement("canvas"));
      const view = new RobotView(canvas, robot);
      let colour;
      view.disc = (place, radius, inside) => (colour = inside); // the last one is the centre's
      const run = { phases: [1], isLifted: (_, wheel) => lifted.includes(wheel) };
      const pose = { phi: Array(8).fill(0), w: robot.w_d, tips };
      const colours = { gravity: "orange", lifted: "red" };
      view.draw(run, pose, 0, Array(8).fill(0.1), [-1, -1, 2, 1], colours);
      return colour;
    }"""
    with with_scripts(browser, "robot.js") as page:
        for lifted, tips, colour in (
            ([1, 2, 3], False, "orange"),
            ([4, 5, 6, 7, 8], False, "red"),  # the rear half hangs in the air
            ([1, 2, 3], True, "red"),
            (list(range(1, 9)), False, "red"),  # no polygon at all
        ):
            assert page.evaluate(call, [robot, lifted, tips]) == colour, (lifted, tips)


def test_tab__reaches_every_control_and_shows_where_it_is(opened: Opened) -> None:
    page = opened.page
    page.focus("#player")
    seen, rings = [], []
    for _ in range(8):
        page.keyboard.press("Tab")
        seen.append(page.evaluate("document.activeElement.id"))
        rings.append(
            page.evaluate(
                "(style => style.outlineStyle !== 'none' && style.outlineWidth !== '0px')"
                "(getComputedStyle(document.activeElement))"
            )
        )
    assert seen == ["previous", "episode", "next", "play", "scrub", "speed", "left", "right"]
    assert all(rings)
    unnamed = page.evaluate(
        "[...document.querySelectorAll('button, select, input')].filter(one => !("
        "one.ariaLabel || one.labels?.[0]?.innerText || one.innerText.trim())).map(one => one.id)"
    )
    assert unnamed == []


def test_arrows__on_the_scrubber_do_what_they_do_elsewhere(opened: Opened) -> None:
    opened.page.focus("#scrub")
    opened.page.keyboard.press("ArrowRight")
    assert opened.time() == pytest.approx(1.0)


def test_figure_4__shows_the_policy_that_is_chosen(opened: Opened) -> None:
    page = opened.page
    visible = "all => all.filter(one => one.checkVisibility()).map(one => one.dataset.tasksOf)"
    assert page.eval_on_selector_all("[data-tasks-of]", visible) == ["0"]
    page.select_option("#figure-4", "2")
    assert page.eval_on_selector_all("[data-tasks-of]", visible) == ["2"]


BACKGROUND = "() => getComputedStyle(document.body).backgroundColor"


def test_theme__follows_the_system_and_the_button(
    browser: Any, report: Path, opened: Opened
) -> None:
    light, drawn = opened.page.evaluate(BACKGROUND), opened.pixels()
    opened.page.click("#theme")
    dark = opened.page.evaluate(BACKGROUND)
    assert (
        sum(map(int, re.findall(r"\d+", light)))
        > 600
        > 150
        > sum(map(int, re.findall(r"\d+", dark)))
    )
    assert opened.pixels() != drawn
    opened.page.reload()
    assert opened.page.evaluate(BACKGROUND) == dark  # it is remembered
    opened.page.click("#theme")
    assert opened.page.evaluate(BACKGROUND) == light
    opened.page.emulate_media(media="print", color_scheme="dark")
    assert opened.page.evaluate(BACKGROUND) == light  # paper is white
    with browser.new_context(color_scheme="dark", reduced_motion="reduce") as context:
        page = Opened(context.new_page(), report).page
        assert page.evaluate(BACKGROUND) == dark


CONTRAST = """() => {
  const luminance = colour => {
    const [r, g, b] = colour.match(/[\\d.]+/g).map(Number).map(v => v / 255)
      .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const probe = document.body.appendChild(document.createElement('i'));
  const of = name => {
    probe.style.color = `var(--${name})`;
    return luminance(getComputedStyle(probe).color);
  };
  const hues = Array.from({length: 8}, (_, k) => `hue-${k}`);
  const names = ['ink', 'soft', 'accent', 'lifted', ...hues];
  return Object.fromEntries(names.map(name => {
    const [a, b] = [of(name), of('page')].sort((x, y) => y - x);
    return [name, (a + 0.05) / (b + 0.05)];
  }));
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours__are_strong_enough_to_read(browser: Any, report: Path, scheme: str) -> None:
    with browser.new_context(color_scheme=scheme, reduced_motion="reduce") as context:
        page = Opened(context.new_page(), report).page
        contrast = page.evaluate(CONTRAST)
    assert min(contrast.values()) >= 4.5, contrast  # WCAG AA for text


TEXTS = """() => {
  const box = element => {
    const {left, right, top, bottom} = element.getBoundingClientRect();
    return [left, right, top, bottom];
  };
  const shown = [...document.querySelectorAll('figure svg')].filter(svg => svg.checkVisibility());
  return shown.map(svg => ({
    title: svg.getAttribute('aria-label'),
    svg: box(svg),
    texts: [...svg.querySelectorAll('text')].filter(text => text.textContent.trim())
      .map(text => [text.textContent, box(text)]),
  }));
}"""


@pytest.mark.parametrize("width", [360, 1280])
def test_charts__have_no_text_cut_off_or_under_another(
    browser: Any, report: Path, width: int
) -> None:
    with browser.new_context(
        viewport={"width": width, "height": 800}, reduced_motion="reduce"
    ) as context:
        page = Opened(context.new_page(), report).page
        drawings = page.evaluate(TEXTS)
    assert len(drawings) == 6 + 3 + 8
    for drawing in drawings:
        left, right, top, bottom = drawing["svg"]
        boxes = drawing["texts"]
        for text, (x0, x1, y0, y1) in boxes:
            assert left - 1 <= x0 <= x1 <= right + 1, (drawing["title"], text)
            assert top - 1 <= y0 <= y1 <= bottom + 1, (drawing["title"], text)
        for k, (one, (a0, a1, b0, b1)) in enumerate(boxes):
            for other, (c0, c1, d0, d1) in boxes[:k]:
                slack = 4 if width > 400 else 2  # line boxes are taller than letters
                apart = a1 <= c0 + 1 or c1 <= a0 + 1 or b1 <= d0 + slack or d1 <= b0 + slack
                assert apart, (drawing["title"], one, other)


@pytest.mark.parametrize("width", [320, 360, 768])
def test_phone__needs_no_sideways_scrolling(browser: Any, report: Path, width: int) -> None:
    with browser.new_context(
        viewport={"width": width, "height": 740}, has_touch=True, reduced_motion="reduce"
    ) as context:
        page = Opened(context.new_page(), report).page
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        boxes = page.eval_on_selector_all(
            "#player canvas, #player button, #player select, #player input",
            "all => all.map(one => [one, one.getBoundingClientRect()])"
            ".map(([one, {left, right}]) => [one.id, left, right])",
        )
        for name, left, right in boxes:
            assert 0 <= left < right <= width, name


def test_motion__starts_by_itself_only_for_who_likes_it(
    browser: Any, report: Path, opened: Opened
) -> None:
    opened.page.locator("#player").scroll_into_view_if_needed()
    opened.page.wait_for_timeout(300)
    assert opened.time() == 0
    with browser.new_context(reduced_motion="no-preference") as context:
        page = Opened(context.new_page(), report).page
        assert page.evaluate(TIME) == 0
        page.evaluate("document.querySelector('#player').scrollIntoView()")
        page.wait_for_function("() => Number(document.querySelector('#scrub').value) > 0.5")


def test_geometry__is_that_of_the_package(browser: Any) -> None:
    robot = {"n_joints": 8, "l": PAPER.l, "track": PAPER.track}
    with with_scripts(browser, "robot.js") as page:
        for seed in range(20):
            state = random_state(seed, PAPER)
            place = geometry(state.phi, state.w, PAPER)
            call = "([phi, w, robot]) => geometry(phi, w, robot)"
            found = page.evaluate(call, [state.phi.tolist(), state.w.tolist(), robot])
            np.testing.assert_allclose(found["outline"], place.outline, atol=1e-12)
            np.testing.assert_allclose(found["centres"], place.centres, atol=1e-12)
            np.testing.assert_allclose(found["axles"], place.axles, atol=1e-12)
            np.testing.assert_allclose(found["gravity"], place.gravity, atol=1e-12)
            points = place.axles.reshape(-1, 2)
            hull = page.evaluate("points => convexHull(points)", points.tolist())
            np.testing.assert_allclose(hull, convex_hull(points), atol=1e-12)


def test_runs__are_decoded_as_they_were_encoded(browser: Any) -> None:
    row = rows_of("analytic")[0]
    motion = motion_of(row, SUITE.initial(0, PAPER), PAPER)
    run = {**encode(motion, PAPER), "outcome": row["outcome"], "phase": 9, "error": "", "modes": []}
    robot = {"n_joints": 8, "quantum": 1e-4, "frame_s": 0.1, "delta_t": 3.0, "w_d": [0, 0, 3]}
    times = [0.0, 0.1, 0.37, 2.9, 3.0, row["time_s"] - 0.01, row["time_s"], 1e6]
    call = """([run, robot, times]) => {
      const decoded = new Run(run, robot);
      return times.map(time => [decoded.at(time).phi, decoded.interval(time)]);
    }"""
    with with_scripts(browser, "robot.js") as page:
        found = page.evaluate(call, [run, robot, times])
    clock = np.arange(len(motion.phi)) * PAPER.dt
    for time, (phi, interval) in zip(times, found, strict=True):
        wanted = [np.interp(time, clock, motion.phi[:, k]) for k in range(8)]
        np.testing.assert_allclose(phi, wanted, atol=2e-3)  # the frames are straight between
        assert interval == min(int(time / 3 + 1e-9), row["intervals"] - 1)
