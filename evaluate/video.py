"""Videos of two policies on one task and one clock: MP4 where imageio-ffmpeg is installed, else GIF."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluate.protocol import Row
from evaluate.report.episodes import Choice, fastest_other, mode_choosing
from evaluate.report.motion import Motion, motion_of
from evaluate.report.replays import SIM_1, Replayed, collect, sim_1
from snake_env.errors import InvalidInputError, printable
from snake_env.params import SnakeParams
from snake_env.rendering.drawing import INK
from snake_env.rendering.painter import HEIGHT, WIDTH, Painter
from snake_env.rendering.scenes import FRAME_EVERY_S, FRAMES_PER_SECOND, Scene
from snake_env.sim.tasks import TaskSuite
from snake_env.system.files import replacing

if TYPE_CHECKING:
    from PIL import Image

DEFAULT = "default"
"""sim-1, the median task and the slowest one."""
_STRIP = 32  # pixels above the pictures, for the policies' names
_MOST_FRAMES = 600  # a longer episode is played faster
_LAST_S = 2.0  # how long the end is to be seen


def check_wish(wish: str, suite: TaskSuite) -> None:
    """Raises where ``--video`` asks for something that can't be shown.

    Raises:
        InvalidInputError: It is neither :data:`DEFAULT` nor a list of tasks of the suite.
    """
    names = [] if wish == DEFAULT else wish.split(",")
    for name in names:
        if name != SIM_1 and not (name.isdecimal() and int(name) < len(suite)):
            expected = f"{DEFAULT}, or a list of {SIM_1} and tasks from 0 to {len(suite) - 1}"
            raise InvalidInputError("video", wish, expected)


def write_videos(
    folder: Path,
    wish: str,
    policies: Sequence[str],
    rows: Mapping[str, Sequence[Row]],
    params: SnakeParams,
    suite: TaskSuite,
    decision_timeout_s: float | None = None,
    *,
    missing: bool = False,
) -> list[Path]:
    """Writes ``video-TASK.mp4`` or ``.gif`` for each task: the first policy, and the fastest other.

    Args:
        folder: Where to.
        wish: :data:`DEFAULT`, or tasks with commas between them.
        policies: The policies in their order.
        rows: Their episodes, by task.
        params: The constants.
        suite: The tasks.
        decision_timeout_s: What a decision may take [s]; None: any time.
        missing: Whether videos that are there already stay.

    Returns:
        The files that are written.
    """
    first_simulation = sim_1(rows, params, suite, decision_timeout_s)
    return [
        _write(folder / name, episode, params)
        for episode in _wanted(wish, policies, rows, params, suite, first_simulation)
        for name in [f"video-{episode.name.replace(' ', '-')}"]
        if not (missing and any(folder.glob(f"{name}.*")))
    ]


def _wanted(
    wish: str,
    policies: Sequence[str],
    rows: Mapping[str, Sequence[Row]],
    params: SnakeParams,
    suite: TaskSuite,
    first_simulation: list[Replayed],
) -> list[Replayed]:
    if wish == DEFAULT:
        episodes = collect(policies, rows, params, suite)
        return first_simulation + [e for e in episodes if e.choice.group == "Typical"]
    wanted = []
    choosing = mode_choosing(policies)
    for name in dict.fromkeys(wish.split(",")):
        if name == SIM_1:
            wanted += first_simulation
            continue
        task = int(name)
        runs = {p: next(row for row in rows[p] if row["task"] == task) for p in policies}
        second = fastest_other(choosing, runs, choosing[0])
        choice = Choice(task, "", "", choosing[0], second, choosing[0])
        wanted.append(Replayed(f"task {task}", choice, suite.initial(task, params), runs))
    return wanted


def _write(name: Path, episode: Replayed, params: SnakeParams) -> Path:
    shown = dict.fromkeys((episode.choice.left, episode.choice.right))
    motions = {policy: motion_of(episode.rows[policy], episode.state, params) for policy in shown}
    longest = max(len(motion.phi) for motion in motions.values()) * params.dt
    every_s = max(FRAME_EVERY_S, longest / _MOST_FRAMES)
    sides = {
        policy: _scenes(motion, episode, policy, params, every_s)
        for policy, motion in motions.items()
    }
    painter = Painter(params)
    painter.begin([scene for scenes in sides.values() for scene in scenes])  # one view for all
    count = max(map(len, sides.values()))
    frames = (_frame(painter, sides, k) for k in range(count))
    path = name.with_name(f"{name.name}.gif")
    if importlib.util.find_spec("imageio_ffmpeg") is not None:
        path = name.with_name(f"{name.name}.mp4")
        _save_mp4(frames, (WIDTH * len(sides), HEIGHT + _STRIP), path)
        return path
    from PIL import Image

    no_dither = Image.Dither.NONE
    palette = painter.quantized([_frame(painter, sides, count // 2)])[0]
    _save_gif((frame.quantize(palette=palette, dither=no_dither) for frame in frames), count, path)
    return path


def _scenes(
    motion: Motion, episode: Replayed, policy: str, params: SnakeParams, every_s: float
) -> list[Scene]:
    """A scene every ``every_s``, and one at the end."""
    outcome = episode.rows[policy]["outcome"]
    last = len(motion.phi) - 1
    every = max(1, round(every_s / params.dt))
    ending = "" if outcome == "success" else outcome
    return [
        _scene(motion, step, episode, params, ending if step == last else "")
        for step in [*range(0, last, every), last]
    ]


def _scene(motion: Motion, step: int, episode: Replayed, params: SnakeParams, alarm: str) -> Scene:
    time = step * params.dt
    over = step == len(motion.phi) - 1 and not alarm
    k = min(int(time / params.delta_t + 1e-9), len(motion.phases) - 1)
    grounded = over or k < 0
    return Scene(
        phi=motion.phi[step],
        w=motion.w[step],
        target=episode.state.target,
        lifted=np.zeros(params.n_joints, dtype=np.bool_) if grounded else motion.lifted[k],
        scp=0 if grounded else motion.phases[k],
        time=time,
        caption="target reached" if over else "" if k < 0 else f"phase {motion.phases[k]}",
        alarm=alarm,
    )


def _frame(painter: Painter, sides: Mapping[str, Sequence[Scene]], k: int) -> Image.Image:
    """The policies' pictures beside each other; one that is done waits."""
    from PIL import Image, ImageDraw, ImageFont

    frame = Image.new("RGB", (WIDTH * len(sides), HEIGHT + _STRIP), INK)
    pen = ImageDraw.Draw(frame)
    font = ImageFont.load_default(18)
    for column, (policy, scenes) in enumerate(sides.items()):
        pen.text(
            (WIDTH * column + 14, _STRIP / 2),
            printable(policy),
            fill="white",
            font=font,
            anchor="lm",
        )
        frame.paste(painter.image(scenes[min(k, len(scenes) - 1)]), (WIDTH * column, _STRIP))
    return frame


def _save_gif(frames: Iterator[Image.Image], count: int, path: Path) -> None:
    durations = [1000 // FRAMES_PER_SECOND] * (count - 1) + [round(1000 * _LAST_S)]
    first = next(frames)
    more: dict[str, Any] = {"append_images": frames, "duration": durations, "loop": 0}
    with replacing(path) as file:
        first.save(file, "GIF", save_all=True, **more)


def _save_mp4(frames: Iterable[Image.Image], size: tuple[int, int], path: Path) -> None:
    import imageio_ffmpeg

    with replacing(path) as file:
        writer = imageio_ffmpeg.write_frames(
            file.name,
            size,
            fps=FRAMES_PER_SECOND,
            macro_block_size=2,
            ffmpeg_log_level="quiet",
            output_params=["-f", "mp4"],
        )
        writer.send(None)  # starts it
        count = 0
        for frame in frames:
            writer.send(pixels := frame.tobytes())
            count += 1
        for _ in range(round(_LAST_S * FRAMES_PER_SECOND)):
            writer.send(pixels)
            count += 1
        writer.close()
        if _frames_in(file.name) != count:  # ffmpeg does not report a full disk
            raise OSError(f"{path} could not be written (is the disk full?)")


def _frames_in(file: str) -> int:
    """How many frames a video holds; 0 where it is damaged."""
    import imageio_ffmpeg

    try:
        count, _ = imageio_ffmpeg.count_frames_and_secs(file)
    except RuntimeError:
        return 0
    return int(count)
