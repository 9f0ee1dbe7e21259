"""The constants: Table I, the presets, and what is refused."""

import dataclasses
import math
import pickle

import numpy as np
import pytest

from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.params import SnakeParams, parse_overrides
from tests.support.robots import PAPER

FIELDS = {field.name: field.default for field in dataclasses.fields(SnakeParams)}
NUMBERS = [name for name, value in FIELDS.items() if isinstance(value, float)]
POSITIVE = [
    *("l", "track", "delta_t", "dt", "horizon", "cam_time", "epsilon_p", "c_phi", "d_0"),
    *("det_floor", "k_0", "phi_limit", "u_limit"),
]
NON_NEGATIVE = ["a_l", "a_c", "a_s", "a_scp", "k_eta", "limit_tolerance"]


def test_defaults__are_table_1() -> None:
    table_1 = {
        "n_joints": 8, "l": 0.091, "delta_t": 3.0, "c_phi": math.pi / 4, "d_0": 0.27,
        "a_l": 2.1, "a_c": 670.0, "a_s": 2e-3, "a_scp": 1e-4, "w_d": (0.0, 0.0, math.pi),
        "k_0": math.pi / 4, "k_eta": 2.0, "gains": (1.0, 1.0, 0.5, 2.0),
        "phi_limit": math.pi / 2, "u_limit": math.pi / 4, "dt": 0.02,
    }  # fmt: skip
    assert {name: getattr(PAPER, name) for name in table_1} == table_1


def test_defaults__close_what_the_paper_leaves_open() -> None:
    choices = {
        "track": 0.10, "head_contact": True, "horizon": 100, "cam_time": 1.5, "epsilon_p": 0.05,
        "det_floor": 1e-6, "limit_tolerance": 1e-6,
    }  # fmt: skip
    assert {name: getattr(PAPER, name) for name in choices} == choices


def test_preset__hardware_is_section_6() -> None:
    changed = {"dt": 0.2, "a_c": 67.0, "gains": (1.0, 1.0, 0.5, 0.5), "k_eta": 1.0}
    assert SnakeParams.preset("hardware") == dataclasses.replace(PAPER, **changed)
    assert SnakeParams.preset("hardware").n_steps == 15


def test_preset__narrow_only_takes_link_0_off_the_ground() -> None:
    assert SnakeParams.preset("narrow") == dataclasses.replace(PAPER, head_contact=False)


def test_preset__overrides_win() -> None:
    params = SnakeParams.preset("hardware", dt=0.1, n_joints=6)
    assert (params.dt, params.n_joints, params.a_c) == (0.1, 6, 67.0)


def test_derived_constants__follow_from_the_fields() -> None:
    assert (PAPER.n_steps, PAPER.horizon_s) == (150, 300.0)
    assert PAPER.replace(dt=0.03, horizon=7, l=0.5).n_steps == 100
    assert PAPER.replace(horizon=7).horizon_s == 21.0
    assert PAPER.replace(l=0.5).d_collision == 1.0


def test_params__are_immutable_hashable_and_picklable() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        PAPER.l = 1.0  # type: ignore[misc]
    assert len({PAPER, SnakeParams(), PAPER.replace(l=0.1)}) == 2
    assert pickle.loads(pickle.dumps(PAPER)) == PAPER


def test_params__keep_plain_python_values() -> None:
    params = SnakeParams(n_joints=np.int64(6), l=np.float32(0.5), a_l=2, w_d=np.zeros(3))
    assert (params.n_joints, params.l, params.a_l, params.w_d) == (6, 0.5, 2.0, (0.0, 0.0, 0.0))
    assert {type(params.n_joints), type(params.l), type(params.a_l)} == {int, float}
    assert type(params.w_d) is tuple


@pytest.mark.parametrize("value", ["fast", None, [1.0], math.nan, math.inf, True, 1j])
@pytest.mark.parametrize("name", NUMBERS)
def test_number__refuses_what_is_no_finite_number(name: str, value: object) -> None:
    _assert_refused(name, value)


def test_number__refuses_integers_too_large_for_a_float() -> None:
    _assert_refused("a_l", 10**400)


@pytest.mark.parametrize("value", ["8", 8.0, 8.5, None, True, math.nan, np.array(8.5)])
@pytest.mark.parametrize("name", ["n_joints", "horizon"])
def test_integer__refuses_what_is_no_integer(name: str, value: object) -> None:
    _assert_refused(name, value)


@pytest.mark.parametrize("value", [1, 0, "yes", None])
def test_head_contact__refuses_what_is_no_bool(value: object) -> None:
    _assert_refused("head_contact", value)


@pytest.mark.parametrize(
    "value", [1.0, None, "1234", (1.0,), (1.0,) * 5, (1.0, 1.0, math.nan, 1.0), ("a",) * 4]
)
def test_gains__refuse_wrong_lengths_and_entries(value: object) -> None:
    _assert_refused("gains", value)


@pytest.mark.parametrize("value", [1.0, None, "123", (0.0, 0.0), (0.0, math.inf, 0.0), ("a",) * 3])
def test_w_d__refuses_wrong_lengths_and_entries(value: object) -> None:
    _assert_refused("w_d", value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, 0) for name in POSITIVE),
        *((name, -1) for name in POSITIVE),
        *((name, -1) for name in NON_NEGATIVE),
        *(("n_joints", value) for value in (-1, 0, 4, 17)),
        *(("gains", (1.0, 1.0, 0.5, value)) for value in (0.0, -2.0)),
        *(("phi_limit", value) for value in (math.pi, 4.0)),
        *(("dt", value) for value in (0.7, 4.0, 5e-324)),
    ],
)
def test_field__refuses_values_out_of_its_range(name: str, value: object) -> None:
    _assert_refused(name, value)


@pytest.mark.parametrize("name", NON_NEGATIVE)
def test_weight__may_be_zero(name: str) -> None:
    assert getattr(PAPER.replace(**{name: 0}), name) == 0.0


def test_range_tests__cover_every_number() -> None:
    assert set(NUMBERS) | {"horizon"} == {*POSITIVE, *NON_NEGATIVE}


def test_unknown_preset__gets_a_suggestion() -> None:
    with pytest.raises(UnknownNameError, match=r"preset 'hardwear'.*did you mean 'hardware'"):
        SnakeParams.preset("hardwear")


@pytest.mark.parametrize("make", [PAPER.replace, lambda **o: SnakeParams.preset("paper", **o)])
def test_unknown_parameter__gets_a_suggestion(make) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(UnknownNameError, match=r"parameter 'phi_limt'.*did you mean 'phi_limit'"):
        make(phi_limt=1.0)


def _assert_refused(name: str, value: object) -> None:
    """The error is typed, on one line, and names field and value."""
    with pytest.raises(InvalidInputError) as caught:
        PAPER.replace(**{name: value})
    error = caught.value
    assert error.field == name
    assert error.value is value or error.value == value or repr(value) in repr(error.value)
    message = str(error)
    assert message.startswith(f"{name} = ")
    assert "expected" in message
    assert "\n" not in message


def test_constant_that_is_given_twice__is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"^set = 'a_c=2': expected a_c only once$"):
        parse_overrides(["a_c=1", "l=0.1", "a_c=2"])


def test_overrides__of_any_depth_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="expected NAME=VALUE"):
        parse_overrides(["gains=" + "[" * 20_000])
