"""What a user of `make_vec` relies on: seeds, damage distributions, infos, copies and clear errors."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ClassTable, ConfigError, DappoError, ShapeError, SimulationError
from dappo_batch.envs.options import completed

# 99.9 % quantile of the chi-square distribution with 32 degrees of freedom (any statistics table).
CHI_SQUARE_32 = 62.487


def make(table: ClassTable, num_envs: int = 3, **options: Any) -> dappo_batch.DamageVectorEnv:  # noqa: ANN401
    return dappo_batch.make_vec(table, num_envs, **({"seed": 0, "threads": 1} | options))


def play(envs: dappo_batch.DamageVectorEnv, steps: int, seed: int = 0) -> list[Any]:
    """Return everything that a reset and `steps` random steps give."""
    rng = np.random.default_rng(seed)
    history: list[Any] = [envs.reset()]
    for _ in range(steps):
        history.append(envs.step(rng.uniform(-1, 1, envs.action_space.shape).astype(np.float32)))  # noqa: PERF401
    return history


def test_the_spaces_have_the_sizes_of_the_paper(ant_table: ClassTable, hexapod_table: ClassTable) -> None:
    for table, sizes, actions in ((ant_table, (111, 119), 8), (hexapod_table, (53, 65), 18)):
        for observe_damage, size in zip((False, True), sizes, strict=True):
            envs = make(table, observe_damage=observe_damage)
            assert envs.single_observation_space.shape == (size,)
            assert envs.observation_space.shape == (3, size)
            assert envs.single_action_space.shape == (actions,)
            assert envs.action_space.shape == (3, actions)
            obs, _ = envs.reset()
            assert obs in envs.observation_space


def test_the_env_declares_its_autoreset_mode_and_its_frame_rate(table: ClassTable) -> None:
    frames = {"ant": 20, "hexapod": 67}[table.robot.name]  # 1 / 0.05 s and 1 / 0.015 s
    for name, mode in (("same_step", AutoresetMode.SAME_STEP), ("NextStep", AutoresetMode.NEXT_STEP)):
        envs = make(table, autoreset=name)
        assert envs.autoreset_mode is mode
        assert envs.metadata == {"render_modes": ["rgb_array"], "render_fps": frames, "autoreset_mode": mode}


def test_results_do_not_depend_on_the_number_of_threads(
    assert_identical: Callable[..., None], table: ClassTable, backend: str
) -> None:
    options = {"max_episode_steps": 9, "autoreset": "same_step", "onset": (0, 5), "backend": backend}
    one, two = (make(table, 40, threads=threads, **options) for threads in (1, 2))
    assert (one.num_threads, two.num_threads) == (1, 2)
    assert_identical(tuple(play(one, 25)), tuple(play(two, 25)))


def test_an_integer_seed_gives_env_i_the_seed_plus_i(ant_table: ClassTable) -> None:
    whole = make(ant_table, 4).reset(seed=20)[0]
    shifted = make(ant_table, 3).reset(seed=21)[0]
    listed = make(ant_table, 4).reset(seed=[20, 21, 22, 23])[0]
    built = make(ant_table, 4, seed=20).reset()[0]
    np.testing.assert_array_equal(whole[1:], shifted)
    np.testing.assert_array_equal(whole, listed)
    np.testing.assert_array_equal(whole, built)
    assert len(np.unique(whole[:, 0])) == 4


def test_a_reset_without_seed_continues_the_random_streams(ant_table: ClassTable) -> None:
    envs = make(ant_table, 3)
    first, second = envs.reset(seed=5)[0], envs.reset()[0]
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(envs.reset(seed=5)[0], first)
    np.testing.assert_array_equal(envs.reset()[0], second)
    mixed = envs.reset(seed=[5, None, 7])[0]
    np.testing.assert_array_equal(mixed[[0, 2]], first[[0, 2]])
    assert not np.array_equal(mixed[1], first[1])
    assert not np.array_equal(mixed[1], second[1])


def test_envs_made_without_a_seed_all_differ(ant_table: ClassTable) -> None:
    starts = np.concatenate([make(ant_table, 3, seed=None).reset()[0] for _ in range(2)])
    assert len(np.unique(starts[:, 0])) == 6


def test_initial_states_have_the_distribution_of_gymnasiums(ant_table: ClassTable) -> None:
    envs = make(ant_table, 2000, damage="healthy")
    envs.reset()
    qpos, qvel = envs.get_state()
    start = ant_table.models[0].qpos0
    noise = qpos - start
    noise[:, 3:7] = 0.0  # the quaternion may be normalised by the simulation
    assert np.abs(noise).max() <= 0.1
    # A uniform variable in ±0.1 has the standard deviation 0.1 / sqrt(3); bounds are five standard errors.
    free = np.r_[0:3, 7:15]
    np.testing.assert_allclose(noise[:, free].std(axis=0), 0.1 / np.sqrt(3), rtol=0.06)
    np.testing.assert_allclose(noise[:, free].mean(axis=0), 0.0, atol=0.0065)
    np.testing.assert_allclose(qvel.std(axis=0), 0.1, rtol=0.08)
    np.testing.assert_allclose(qvel.mean(axis=0), 0.0, atol=0.0112)


def test_uniform_damage_draws_every_class_equally_often(ant_table: ClassTable) -> None:
    envs = make(ant_table, 3300)
    counts = np.zeros(33)
    for _ in range(2):  # two episodes, as every reset draws
        classes = envs.reset()[1]["damage_class"]
        counts += np.bincount(classes, minlength=33)
    assert ((counts - 200.0) ** 2 / 200.0).sum() < CHI_SQUARE_32


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        ("healthy", {0: 1.0}),
        ("missing_toe@1", {"missing_toe@1": 1.0}),
        (7, {7: 1.0}),
        ([0, "jammed_joint@3", np.int64(12)], {0: 1 / 3, "jammed_joint@3": 1 / 3, 12: 1 / 3}),
        (np.array([4, 5]), {4: 0.5, 5: 0.5}),
        (
            {"healthy": 3, "jammed_joint@0+missing_toe@2": 1.0},
            {0: 0.75, "jammed_joint@0+missing_toe@2": 0.25},
        ),
        (np.eye(33)[9] + np.eye(33)[11], {9: 0.5, 11: 0.5}),
        ((np.eye(33)[9] * 0.6).tolist(), {9: 1.0}),
    ],
    ids=["healthy", "spec", "id", "list", "id array", "mapping", "weight array", "weight list"],
)
def test_damage_is_drawn_from_what_the_user_gives(
    ant_table: ClassTable,
    damage: Any,  # noqa: ANN401
    expected: dict[int | str, float],
) -> None:
    envs = make(ant_table, 3000, damage=damage)
    classes = envs.reset()[1]["damage_class"]
    shares = np.bincount(classes, minlength=33) / 3000
    wanted = np.zeros(33)
    for spec, share in expected.items():
        wanted[ant_table.space.parse(spec)] = share
    # Five standard errors of a share of one half in 3000 draws.
    np.testing.assert_allclose(shares, wanted, atol=0.046)
    assert not shares[wanted == 0.0].any()


def test_reset_options_choose_class_and_onset_of_each_env(ant_table: ClassTable) -> None:
    envs = make(ant_table, 4, damage="healthy", onset=2)
    _, infos = envs.reset(
        options={"damage_class": ["healthy", 3, "missing_toe@2", None], "onset": [0, 0, 5, -1]}
    )
    np.testing.assert_array_equal(infos["damage_onset"], [0, 0, 5, 2])
    np.testing.assert_array_equal(infos["damage_class"], [0, 3, 0, 0])
    _, infos = envs.reset(options={"damage_class": "missing_toe@2", "onset": 0})
    np.testing.assert_array_equal(infos["damage_class"], [ant_table.space.parse("missing_toe@2")] * 4)
    _, infos = envs.reset()
    np.testing.assert_array_equal(infos["damage_class"], [0] * 4)


def test_options_hold_for_one_episode_only(ant_table: ClassTable) -> None:
    envs = make(ant_table, 2, damage="healthy", max_episode_steps=2, autoreset="same_step")
    envs.reset(options={"damage_class": 5})
    actions = np.zeros((2, 8), dtype=np.float32)
    classes = [envs.step(actions)[4]["damage_class"].tolist() for _ in range(2)]
    assert classes == [[5, 5], [0, 0]]


def test_the_onset_range_is_inclusive_and_drawn_per_episode(ant_table: ClassTable) -> None:
    envs = make(ant_table, 500, damage=[1], onset=(3, 6))
    onsets = envs.reset()[1]["damage_onset"]
    assert set(onsets.tolist()) == {3, 4, 5, 6}
    assert not np.array_equal(onsets, envs.reset()[1]["damage_onset"])


def test_observations_end_with_the_damage_code_of_the_active_damage(table: ClassTable) -> None:
    count = len(table.models)
    plain, coded = make(table, count, observe_damage=False), make(table, count)
    options = {"damage_class": np.arange(count)}
    obs = coded.reset(seed=1, options=options)[0]
    codes = np.array([damage.code for damage in table.space.classes], dtype=np.float32)
    np.testing.assert_array_equal(obs[:, -codes.shape[1] :], codes)
    np.testing.assert_array_equal(obs[:, : -codes.shape[1]], plain.reset(seed=1, options=options)[0])


def test_severity_and_number_of_damaged_limbs_are_parameters() -> None:
    envs = dappo_batch.make_vec("ant", 2, severity=0.5, max_damaged_limbs=1, seed=0)
    assert len(envs.table.models) == 9  # 1 healthy + 2 types on each of 4 limbs
    np.testing.assert_array_equal(envs.reset()[1]["severity"], [0.5, 0.5])


def test_returned_arrays_are_copies_unless_the_user_asks_for_views(ant_table: ClassTable) -> None:
    actions = np.full((3, 8), 0.5, dtype=np.float32)

    def arrays(returned: tuple[Any, ...]) -> list[NDArray[Any]]:
        return [*returned[:4], *returned[4].values()]

    copies = make(ant_table)
    copies.reset()
    first, second = arrays(copies.step(actions)), arrays(copies.step(actions))
    assert not any(np.shares_memory(one, two) for one, two in zip(first, second, strict=True))
    views = make(ant_table, copy=False)
    views.reset()
    first, second = arrays(views.step(actions)), arrays(views.step(actions))
    assert all(np.shares_memory(one, two) for one, two in zip(first[:4], second[:4], strict=True))


def test_other_libraries_share_the_memory_of_views_through_dlpack(ant_table: ClassTable) -> None:
    views = make(ant_table, copy=False)
    obs, _ = views.reset()
    shared = np.from_dlpack(obs)
    assert np.shares_memory(shared, obs)
    returned = views.step(np.full((3, 8), 0.5, dtype=np.float32))
    np.testing.assert_array_equal(shared, returned[0])
    assert all(array.__dlpack_device__() == (1, 0) for array in returned[:4])  # host memory


def test_views_and_copies_hold_the_same_values(
    assert_identical: Callable[..., None], ant_table: ClassTable
) -> None:
    options = {"autoreset": "same_step", "max_episode_steps": 4}
    copies, views = make(ant_table, **options), make(ant_table, copy=False, **options)
    assert_identical(copies.reset(), views.reset())
    actions = np.full((3, 8), 0.5, dtype=np.float32)
    for _ in range(10):
        assert_identical(copies.step(actions), views.step(actions))


def test_actions_beyond_the_bounds_are_clipped_and_other_real_types_converted(ant_table: ClassTable) -> None:
    rng = np.random.default_rng(0)
    wild = rng.uniform(-3, 3, (3, 8)).astype(np.float32)
    results = []
    for actions in (
        wild,
        np.clip(wild, -1, 1),
        wild.astype(np.float64),
        wild.tolist(),
        np.asfortranarray(wild),
    ):
        envs = make(ant_table)
        envs.reset()
        results.append(envs.step(actions)[0])
    for result in results[1:]:
        np.testing.assert_array_equal(result, results[0])


def test_a_state_can_be_set_and_read_back(table: ClassTable, backend: str) -> None:
    envs = make(table, backend=backend, precision="f64")
    envs.reset()
    qpos, qvel = envs.get_state()
    qpos[:, 2] += 0.01
    qvel *= 0.5
    obs = envs.set_state(qpos, qvel)
    for got, wanted in zip(envs.get_state(), (qpos, qvel), strict=True):
        np.testing.assert_array_equal(got, wanted)
    np.testing.assert_array_equal(obs[:, 0], qpos[:, 2].astype(np.float32))
    with pytest.raises(ShapeError):
        envs.set_state(qpos[:2], qvel)


@pytest.mark.parametrize(
    ("actions", "error", "message"),
    [
        (np.zeros((2, 8), dtype=np.float32), ShapeError, r"expected shape \(3, 8\), got \(2, 8\)"),
        (np.zeros(24, dtype=np.float32), ShapeError, r"got \(24,\)"),
        ([[0.0] * 8, [0.0] * 7, [0.0] * 8], ShapeError, "no array"),
        (np.zeros((3, 8), dtype=np.complex128), ConfigError, "complex128"),
        (np.full((3, 8), "left"), ConfigError, "actions"),
        (np.full((3, 8), np.nan, dtype=np.float32), ConfigError, "env 0 is not finite"),
        (np.full((3, 8), np.inf), ConfigError, "not finite"),
        (np.full((3, 8), 1e300), ConfigError, "not finite"),
    ],
)
def test_unusable_actions_are_rejected_and_leave_the_env_as_it_was(
    assert_identical: Callable[..., None],
    ant_table: ClassTable,
    actions: Any,  # noqa: ANN401
    error: type[Exception],
    message: str,
) -> None:
    envs, twin = make(ant_table), make(ant_table)
    envs.reset()
    twin.reset()
    with pytest.raises(error, match=message):
        envs.step(actions)
    good = np.zeros((3, 8), dtype=np.float32)
    assert_identical(envs.step(good), twin.step(good))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"num_envs": 2.0}, "num_envs"),
        ({"damage": "missing_head@0"}, "missing_head"),
        ({"damage": 33}, "0 to 32"),
        ({"damage": [-1]}, "at least 0"),
        ({"damage": [0.5, 0.5]}, "one per class"),
        ({"damage": []}, "at least one"),
        ({"damage": {"healthy": -1.0}}, "not negative"),
        ({"damage": np.zeros(33)}, "at least one"),
        ({"damage": None}, "integer"),
        ({"reward": "money"}, "money"),
        ({"autoreset": "sometimes"}, "sometimes"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**64 - 1}, r"2\*\*64"),
        ({"seed": [1, 2]}, r"expected one seed per env \(3\)"),
        ({"seed": 0.5}, "integer"),
        ({"threads": 0}, "threads"),
        ({"onset": (5, 2)}, "onset"),
        ({"onset": -1}, "onset"),
        ({"max_episode_steps": 0}, "max_episode_steps"),
        ({"physics": "rk4"}, "compile_class_table"),
    ],
)
def test_unusable_settings_are_rejected_with_our_own_errors(
    ant_table: ClassTable, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(DappoError, match=message) as caught:
        make(ant_table, **options)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    "options", [{"severity": 0.0}, {"severity": 1.5}, {"max_damaged_limbs": 5}, {"physics": "quantum"}]
)
def test_unusable_class_tables_are_rejected(options: dict[str, Any]) -> None:
    with pytest.raises(DappoError):
        dappo_batch.make_vec("ant", 1, **options)


def test_an_unknown_robot_is_rejected_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="centipede"):
        dappo_batch.make_vec("centipede", 1)
    with pytest.raises(DappoError, match="centipede"):
        dappo_batch.make_vec(tmp_path / "centipede.toml", 1)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"damage_clas": 3}, ConfigError, "damage_clas"),
        ({"damage_class": "nothing@9"}, ConfigError, "nothing@9"),
        ({"damage_class": 99}, ConfigError, "99"),
        ({"damage_class": [1, 2]}, ShapeError, "expected one value or 3, got 2"),
        ({"onset": -5}, ConfigError, "onset"),
        ({"onset": 1.5}, ConfigError, "integer"),
        ({"reset_mask": np.ones(2, dtype=np.bool_)}, ShapeError, r"\(3,\)"),
        ({"reset_mask": np.ones(3)}, ConfigError, "booleans"),
        ({"reset_mask": np.zeros(3, dtype=np.bool_)}, ConfigError, "at least one env"),
    ],
)
def test_unusable_reset_options_are_rejected(
    ant_table: ClassTable, options: dict[str, Any], error: type[Exception], message: str
) -> None:
    envs = make(ant_table)
    envs.reset()
    with pytest.raises(error, match=message):
        envs.reset(options=options)


def test_an_unknown_argument_is_an_error_with_the_known_ones(ant_table: ClassTable) -> None:
    makers: list[Any] = [dappo_batch.make_vec, dappo_batch.DamageVectorEnv, dappo_batch.DamageEnv]
    for maker in makers:
        with pytest.raises(
            TypeError, match=r"unexpected keyword argument 'sed'; expected some of damage, .*seed"
        ):
            maker(ant_table, sed=0)
    # What only several envs have.
    with pytest.raises(TypeError, match="unexpected keyword argument 'autoreset'"):
        makers[2](ant_table, autoreset="same_step")


@pytest.mark.parametrize("options", [dappo_batch.EnvOptions, dappo_batch.VectorEnvOptions])
def test_every_argument_is_described_and_has_a_default(options: type[dappo_batch.EnvOptions]) -> None:
    described = f"{dappo_batch.EnvOptions.__doc__}{options.__doc__}"
    for name in options.__annotations__:
        assert re.search(rf"^    (\w+, )*{name}(, \w+)* : ", described, re.MULTILINE), name
    assert completed("make_vec", {}, options).keys() == dappo_batch.VectorEnvOptions.__annotations__.keys()


def test_stepping_before_the_first_reset_is_rejected(ant_table: ClassTable) -> None:
    envs = make(ant_table)
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((3, 8), dtype=np.float32))
    with pytest.raises(ResetNeeded):
        envs.reset(options={"reset_mask": np.array([True, False, True])})


def test_a_closed_env_refuses_everything_and_may_be_closed_again(ant_table: ClassTable) -> None:
    envs = make(ant_table)
    obs, _ = envs.reset()
    kept = obs.copy()
    envs.close()
    envs.close()
    np.testing.assert_array_equal(obs, kept)
    calls = (
        lambda: envs.step(np.zeros((3, 8))),
        envs.reset,
        envs.get_state,
        lambda: envs.set_state(obs, obs),
    )
    for call in calls:
        with pytest.raises(SimulationError, match="closed"):
            call()


def test_views_stay_valid_memory_after_close(ant_table: ClassTable) -> None:
    envs = make(ant_table, copy=False)
    obs, _ = envs.reset()
    kept = obs.copy()
    envs.close()
    del envs
    np.testing.assert_array_equal(obs, kept)
