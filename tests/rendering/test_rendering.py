"""Frames: what they show, how many there are, and GIFs."""

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageColor

from snake_env.envs import SnakeModeSelectionEnv
from snake_env.rendering.drawing import GRAVITY, GROUNDED, INK, LIFTED
from snake_env.rendering.painter import Painter, save_gif
from snake_env.rendering.scenes import FRAME_EVERY_S, motion_scenes, still_scene
from snake_env.sim.simulation import predict
from snake_env.state import SnakeState
from tests.support.commands import names
from tests.support.robots import PAPER


def pixels_of(image: np.ndarray, colour: str) -> int:
    """How many pixels are nearly of a colour."""
    distance = np.abs(image.astype(int) - ImageColor.getrgb(colour)).max(axis=2)
    return int((distance < 25).sum())


def test_frame__shows_wheels_head_and_centre_of_gravity(sim_1: SnakeState) -> None:
    painter = Painter(PAPER)
    some_up = painter.frame(motion_scenes(sim_1, 85, PAPER)[0])
    assert some_up.shape == (480, 640, 3)
    assert some_up.dtype == np.uint8
    for colour in (GROUNDED, INK, GRAVITY):
        assert pixels_of(some_up, colour) > 40
    one_up = painter.frame(motion_scenes(sim_1, 0, PAPER)[0])
    assert pixels_of(one_up[64:], LIFTED) < pixels_of(some_up[64:], LIFTED)
    assert pixels_of(one_up[64:], GROUNDED) > pixels_of(some_up[64:], GROUNDED)


def test_motion_scenes__lead_from_one_switching_time_to_the_next(sim_1: SnakeState) -> None:
    scenes = motion_scenes(sim_1, 85, PAPER)
    assert len(scenes) == -(-150 // round(FRAME_EVERY_S / PAPER.dt))
    assert np.diff([scene.time for scene in scenes]).max() <= FRAME_EVERY_S + PAPER.dt
    assert np.array_equal(scenes[-1].phi, predict(sim_1, [85], PAPER).phi[0])


def test_render_list__has_the_motion_once() -> None:
    env = SnakeModeSelectionEnv(render_mode="rgb_array_list")
    env.reset(seed=0)
    assert len(env.render()) == 1
    env.step(0)
    frames = env.render()
    assert len(frames) > 15
    assert not np.array_equal(frames[0], frames[-1])
    assert env.render() == []


def test_render_array__is_the_last_frame() -> None:
    env = SnakeModeSelectionEnv(render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    env.step(0)
    assert first.shape == env.render().shape == (480, 640, 3)
    assert not np.array_equal(first, env.render())


def test_render_human__draws_in_a_window(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr("snake_env.rendering.viewer.FRAMES_PER_SECOND", 1000)
    env = SnakeModeSelectionEnv(render_mode="human")
    env.reset(seed=0)
    env.step(0)
    assert env.render() is None
    import pygame

    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert pixels_of(shown, GROUNDED) > 40
    env.close()
    assert pygame.display.get_surface() is None


def test_view__widens_for_a_robot_that_leaves_it(sim_1: SnakeState) -> None:
    away = sim_1.replace(w=np.array([-1.5, 1.0, 1.0]))
    frame = Painter(PAPER).frame(still_scene(away, PAPER))
    border = np.concatenate([frame[64], frame[-1], frame[64:, 0], frame[64:, -1]])
    assert pixels_of(border[None], INK) == 0
    assert pixels_of(frame[64:], GROUNDED) > 20


def test_joint_of_the_phase__is_marked(sim_1: SnakeState) -> None:
    scene = still_scene(sim_1, PAPER)
    painter = Painter(PAPER)
    painter.begin([scene])
    dark = [
        pixels_of(painter.frame(dataclasses.replace(scene, scp=scp))[64:], INK) for scp in (0, 1, 9)
    ]
    assert dark[1] > dark[0] + 60
    assert dark[0] == dark[2]  # no phase is left


def test_centre_of_gravity__is_red_where_the_robot_tips_over(sim_1: SnakeState) -> None:
    scene = still_scene(sim_1, PAPER)
    painter = Painter(PAPER)
    orange = [
        pixels_of(painter.frame(dataclasses.replace(scene, alarm=alarm))[64:], GRAVITY)
        for alarm in ("", "collision", "stability")
    ]
    assert orange[0] == orange[1] > orange[2] + 30


def test_gif__is_filled_by_start_target_and_motion(sim_1: SnakeState, tmp_path: Path) -> None:
    away = still_scene(sim_1.replace(w=np.array([-0.8, 0.3, 3.0])), PAPER)
    scenes = [*motion_scenes(sim_1, 85, PAPER), away]  # at last it is somewhere else
    save_gif(scenes, tmp_path / "motion.gif", PAPER)
    drawn = np.zeros((480 - 64, 640), dtype=bool)
    heads = []
    with Image.open(tmp_path / "motion.gif") as image:
        for k in range(image.n_frames):
            image.seek(k)
            frame = np.asarray(image.convert("RGB"))[64:].astype(int)
            drawn |= np.abs(frame - frame[0, 0]).max(axis=2) > 25
            dark = np.abs(frame - ImageColor.getrgb(INK)).max(axis=2) < 25
            heads.append(np.flatnonzero(dark.any(axis=0))[0])
    assert heads[0] == heads[-2] > 200 > 100 > heads[-1]  # from the beginning there is room for it
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    spread = np.ptp(rows) / drawn.shape[0], np.ptp(columns) / drawn.shape[1]
    assert max(spread) > 0.85
    assert min(rows[0], columns[0]) > 0  # nothing is cut off
    assert rows[-1] < drawn.shape[0] - 1
    assert columns[-1] < drawn.shape[1] - 1


def test_episodes__each_have_a_view_of_their_own() -> None:
    env = SnakeModeSelectionEnv(render_mode="rgb_array")
    env.reset(seed=4)
    first = env.render()
    for seed in range(5):
        env.reset(seed=seed)
        env.step(0)
    env.reset(seed=4)
    assert np.array_equal(env.render(), first)


def test_gif__has_all_frames_and_keeps_small_marks(sim_1: SnakeState, tmp_path: Path) -> None:
    scenes = motion_scenes(sim_1, 85, PAPER)
    path = tmp_path / "motion.gif"
    save_gif(scenes, path, PAPER)
    with Image.open(path) as image:
        assert image.size == (640, 480)
        assert image.n_frames == len(scenes)
        image.seek(5)
        frame = np.asarray(image.convert("RGB"))
    for colour in (GROUNDED, LIFTED, GRAVITY):
        assert pixels_of(frame, colour) > 15


def test_gif__that_cannot_be_written_leaves_the_old_one(
    sim_1: SnakeState, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full_disk(image: Image.Image, file: Any, *_: object, **__: object) -> None:
        file.write(b"GIF89a")
        raise OSError(28, "No space left on device")

    path = tmp_path / "motion.gif"
    path.write_bytes(b"old")
    monkeypatch.setattr(Image.Image, "save", full_disk)
    with pytest.raises(OSError, match="No space left"):
        save_gif([still_scene(sim_1, PAPER)], path, PAPER)
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == {"motion.gif"}
