"""Videos of two policies on one clock."""

import importlib.util
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from evaluate import video
from evaluate.report.motion import motion_of
from evaluate.report.replays import collect
from evaluate.video import check_wish, write_videos
from snake_env.errors import InvalidInputError
from snake_env.rendering.painter import HEIGHT, WIDTH
from snake_env.rendering.scenes import FRAME_EVERY_S
from tests.support.evaluations import SUITE, rows_of
from tests.support.robots import PAPER

FRAMES = 60


@pytest.fixture(autouse=True)
def few_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes a while."""
    monkeypatch.setattr(video, "_MOST_FRAMES", FRAMES)


@pytest.fixture
def no_ffmpeg(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the extra ``video`` was not installed."""
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *more: None if name == "imageio_ffmpeg" else find(name, *more),
    )


def _write(folder: Path, wish: str, *policies: str) -> list[Path]:
    rows = {policy: rows_of(policy) for policy in policies}
    return write_videos(folder, wish, policies, rows, PAPER, SUITE)


@pytest.mark.usefixtures("no_ffmpeg")
def test_gif__shows_both_until_the_slower_is_done(tmp_path: Path) -> None:
    (path,) = _write(tmp_path, "2", "analytic", "imitate")
    assert path == tmp_path / "video-task-2.gif"
    with Image.open(path) as film:
        assert film.size == (2 * WIDTH, HEIGHT + 32)
        # Frames that equal the one before are one, longer.
        assert 0.8 * FRAMES < film.n_frames <= FRAMES + 2
        frames = [_seek(film, k) for k in (0, film.n_frames // 2, film.n_frames - 1)]
    first, middle, last = frames
    for columns in (slice(0, WIDTH), slice(WIDTH, None)):
        assert (first[:, columns] != middle[:, columns]).any()
        assert (middle[:, columns] != last[:, columns]).any()
        assert len(np.unique(first[:32, columns].reshape(-1, 3), axis=0)) > 1  # its name


def _seek(film: Image.Image, frame: int) -> np.ndarray:
    film.seek(frame)
    return np.asarray(film.convert("RGB")).copy()


@pytest.mark.usefixtures("no_ffmpeg")
def test_one_policy__is_shown_alone(tmp_path: Path) -> None:
    (path,) = _write(tmp_path, "0", "skid")
    with Image.open(path) as film:
        assert film.size == (WIDTH, HEIGHT + 32)


def test_mp4__is_written_where_ffmpeg_is_there(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    (path,) = _write(tmp_path, "1", "analytic", "skid")
    assert path == tmp_path / "video-task-1.mp4"
    count, seconds = ffmpeg.count_frames_and_secs(str(path))
    assert seconds == pytest.approx(FRAMES / 20 + 2.0, abs=0.2)
    assert count == pytest.approx(20 * seconds, abs=2)
    told = subprocess.run(
        [ffmpeg.get_ffmpeg_exe(), "-i", path], capture_output=True, text=True, check=False
    ).stderr
    assert f"{WIDTH}x{HEIGHT + 32}" in told  # skid chooses no modes: analytic is alone


@pytest.mark.usefixtures("no_ffmpeg")
def test_default__is_what_is_typical(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[str, str, str]] = []

    def note(folder: Path, episode: Any, params: Any) -> Path:
        drawn.append((episode.name, episode.choice.left, episode.choice.right))
        return folder / episode.name

    monkeypatch.setattr(video, "_write", note)
    _write(tmp_path, "default", "analytic", "imitate")
    rows = {policy: rows_of(policy) for policy in ("analytic", "imitate")}
    typical = [e for e in collect(list(rows), rows, PAPER, SUITE) if e.choice.group == "Typical"]
    assert [name for name, _, _ in drawn] == ["sim-1", *(episode.name for episode in typical)]
    assert {sides for _, *both in drawn for sides in both} == {"analytic", "imitate"}
    drawn.clear()
    _write(tmp_path, "3,sim-1,3", "imitate", "random", "analytic")
    assert drawn == [("task 3", "imitate", "analytic"), ("sim-1", "imitate", "analytic")]


def test_frames__are_evenly_spaced_and_the_end_is_among_them() -> None:
    rows = {"analytic": rows_of("analytic")}
    (episode,) = [e for e in collect(["analytic"], rows, PAPER, SUITE) if "slowest" in e.choice.why]
    motion = motion_of(rows["analytic"][episode.choice.task], episode.state, PAPER)
    scenes = video._scenes(motion, episode, "analytic", PAPER, FRAME_EVERY_S)
    steps = np.diff([scene.time for scene in scenes])
    assert abs(steps[:-1] - FRAME_EVERY_S).max() <= PAPER.dt / 2 + 1e-9
    assert np.ptp(steps[:-1]) < 1e-9
    assert scenes[-1].time == pytest.approx(rows["analytic"][episode.choice.task]["time_s"])
    assert (scenes[0].caption, scenes[-1].caption) == ("phase 1", "target reached")
    assert scenes[0].lifted.any()
    assert not scenes[-1].lifted.any()


@pytest.mark.parametrize("wish", ["default", "sim-1", "0,5", "sim-1,3"])
def test_wish__may_be(wish: str) -> None:
    check_wish(wish, SUITE)


@pytest.mark.parametrize("wish", ["6", "-1", "x", "1,", "defaults", "1;2", "\u00b2"])
def test_wish__that_cannot_be_shown_is_refused(wish: str) -> None:
    with pytest.raises(InvalidInputError, match=r"expected default, or a list of sim-1 and tasks"):
        check_wish(wish, SUITE)


def test_video_that_is_cut_off__is_an_error_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ffmpeg itself says nothing where the disk is full."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    write = imageio_ffmpeg.write_frames

    def writer(path: str, *args: Any, **options: Any) -> Any:
        inner = write(path, *args, **options)

        class Cut:
            def send(self, frame: Any) -> Any:
                return inner.send(frame)

            def close(self) -> None:
                inner.close()
                with open(path, "r+b") as file:
                    file.truncate(1000)

        return Cut()

    monkeypatch.setattr(imageio_ffmpeg, "write_frames", writer)
    with pytest.raises(OSError, match="could not be written"):
        _write(tmp_path, "2", "analytic", "imitate")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_ffmpeg")
def test_gif_that_can_not_be_written__leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path,) = _write(tmp_path, "2", "analytic")
    old = path.read_bytes()

    def full(*_: Any) -> Any:
        raise OSError("No space left on device")

    monkeypatch.setattr(video, "_frame", full)
    with pytest.raises(OSError, match="No space"):
        _write(tmp_path, "2", "analytic")
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [old]
