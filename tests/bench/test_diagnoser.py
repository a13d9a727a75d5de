"""The benchmark of the diagnoser's training: all trainers do the same work on the same data."""

from __future__ import annotations

import json
import tomllib
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from dappo_batch import ConfigError, SimulationError

from ..python.burnpack import read_burnpack
from ..python.command_line import dappo_batch
from . import diagnoser, rounds
from .autotune import fastest
from .commands import TrainingFailed
from .diagnoser import report, torch_network, trainers
from .diagnoser.__main__ import main
from .diagnoser.data import Dataset, collect
from .diagnoser.task import Task
from .diagnoser.trainers import Sample
from .diagnoser.windows import Windows

TIMESTEPS, ROLLOUTS = 6, 2
PAPER = Task(1, 64, "data", 100, classes=33, timesteps=50, inputs=111)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Collect three rollouts of the Ant, one of them to validate on."""
    return collect("ant", ROLLOUTS + 1, TIMESTEPS, 1, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def task(data: Dataset) -> Task:
    """Train the network of the paper in two minibatches an epoch."""
    return Task(1, 33, str(data.folder), ROLLOUTS, data.classes, TIMESTEPS, data.inputs)


@pytest.fixture(scope="module")
def trained(task: Task, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train one epoch as the benchmark does, and keep the folder."""
    out = tmp_path_factory.mktemp("trained") / "diagnoser"
    settings = trainers.Ours(task).settings(1)
    dappo_batch("diagnose", "train", task.data, "--out", out, "--threads", "1", "--json", "--set", *settings)
    return out


def weights(folder: Path) -> dict[str, np.ndarray[Any, np.dtype[np.float32]]]:
    """Read the weights of a trained diagnoser."""
    entries = read_burnpack(folder / "model" / "weights.bpk").items()
    tensors = {name: entry for name, entry in entries if isinstance(entry, tuple)}
    return {name: np.frombuffer(raw, "<f4").reshape(shape) for name, (_, shape, raw) in tensors.items()}


def test_the_data_has_a_window_of_every_class_for_each_rollout(data: Dataset) -> None:
    assert (data.classes, data.inputs) == (33, 111)
    (path,) = data.folder.glob("*.npy")
    assert np.load(path)["damaged"].shape == (ROLLOUTS + 1, 33, TIMESTEPS, 111)


def test_minibatches_are_standardised_differences_to_the_twin(task: Task) -> None:
    (path,) = Path(task.data).glob("*.npy")
    runs = np.load(path)["damaged"][:ROLLOUTS].astype(np.float64)
    differences = runs[:, :1] - runs
    deviation, mean = differences.std((0, 1, 2)), differences.mean((0, 1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.where(deviation > 1e-6, (differences - mean) / deviation, 0.0).clip(-10.0, 10.0)
    windows, samples = Windows(task), np.array([40, 0, 65])
    assert windows.classes(samples).tolist() == [7, 0, 32]
    read = windows.read(samples)
    assert (read.dtype, read.shape) == (np.float32, (3, TIMESTEPS, 111))
    for inputs, (rollout, damage_class) in zip(read, [(1, 7), (0, 0), (1, 32)], strict=True):
        np.testing.assert_allclose(inputs, expected[rollout, damage_class], rtol=1e-3, atol=1e-4)


def test_inputs_are_standardised_as_by_the_training_of_this_package(
    task: Task, trained: Path, tmp_path: Path
) -> None:
    model = tomllib.loads((trained / "model" / "diagnoser.toml").read_text())
    ours = model["description"]["standardizer"]
    (path,) = Path(task.data).glob("*.npy")
    records, matches = np.load(path), []
    # Which rollout validates is drawn by the training; the others must be those it standardises with.
    for validated in range(ROLLOUTS + 1):
        folder = tmp_path / str(validated)
        folder.mkdir()
        np.save(folder / "rollouts-000000.npy", np.delete(records, validated))
        windows = Windows(replace(task, data=str(folder)))
        matches.append(
            np.allclose(windows.mean, ours["mean"], rtol=1e-5, atol=1e-7)
            and np.allclose(windows.scale, ours["scale"], rtol=1e-5)
        )
    assert sorted(matches) == [False, False, True]


def test_our_training_has_the_network_and_the_minibatches_of_the_task(task: Task, trained: Path) -> None:
    found = weights(trained)
    assert found["lstm.embedding.weight"].shape == (111, 512)
    assert found["lstm.input.weight"].shape == (512, 4 * 32)
    dense = [found[f"hidden.{index}.weight"].shape for index in range(3)] + [found["head.weight"].shape]
    assert dense == [(32, 256), (256, 128), (128, 64), (64, 33)]
    (checkpoint,) = (trained / "checkpoints").iterdir()
    progress = json.loads((checkpoint / "manifest.json").read_text())["progress"]
    assert (progress["steps"], progress["samples"]) == (task.steps, task.samples) == (2, 66)
    config = tomllib.loads((trained / "config.toml").read_text())
    assert (config["dropout"], config["learning_rate"], config["schedule"]) == (0.1, 1e-3, "constant")


@pytest.mark.parametrize(("minibatch", "steps"), [(64, 52), (256, 13), (3300, 1), (5000, 1), (1, 3300)])
def test_an_epoch_is_split_into_minibatches_as_close_to_their_size_as_possible(
    minibatch: int, steps: int
) -> None:
    task = replace(PAPER, minibatch=minibatch)
    assert task.steps == steps
    nearest = min(range(1, 3301), key=lambda count: abs(3300 / minibatch - count))
    assert task.steps == nearest


def product(rows: int, inner: int, columns: int) -> int:
    return 2 * rows * inner * columns


def test_the_operations_of_a_sample_are_those_of_its_products() -> None:
    task = Task(1, 4, "data", 3, classes=4, timesteps=5, inputs=3, embedding=7, lstm=2, hidden=(6, 5))
    assert (task.samples, task.steps) == (12, 3)
    behind = 0
    for inputs, outputs in pairwise([2, 6, 5, 4]):
        # Forward, the gradient of the weights, and that of the inputs.
        behind += product(1, inputs, outputs) + product(inputs, 1, outputs) + product(1, outputs, inputs)
    for _ in range(1, 5):  # the first step has no hidden state before it
        behind += product(1, 2, 8) + product(2, 1, 8) + product(1, 8, 2)
    embedded = product(5, 3, 7) + product(3, 5, 7)
    gates = product(5, 7, 8) + product(7, 5, 8) + product(5, 8, 7)
    assert task.plain_flops == embedded + gates + behind
    folding = product(4, 7, 8) + product(7, 4, 8) + product(4, 8, 7)  # once a minibatch
    assert task.folded_flops == product(5, 3, 8) + product(3, 5, 8) + behind + folding * 3 / 12


def test_metrics_are_summarised_without_the_first_epoch() -> None:
    rows = [
        {"samples": 66 * epoch, "seconds": seconds, "train_loss": 4.0 - epoch}
        for epoch, seconds in enumerate([9.0, 0.5, 0.25], start=1)
    ]
    sample = trainers.sample_of(tuple(rows))
    assert asdict(sample) == {"samples": 132, "seconds": 0.75, "loss": 1.0}
    assert sample.rate == 176.0
    with pytest.raises(TrainingFailed, match="only one epoch"):
        trainers.sample_of(tuple(rows[:1]))
    with pytest.raises(TrainingFailed, match="seconds"):
        trainers.sample_of(({"samples": 1}, {"samples": 2}))


class Pretended(trainers.Trainer):
    """Returns a given duration."""

    key = "pretended"
    about = "pretends"
    note = "version 7"

    def train(self, amount: int) -> Sample:
        return Sample(amount * self._task.samples, 0.5, 1.25)


class PretendedPeer(Pretended):
    key = trainers.Torch.key


def test_ratios_and_bounds_are_those_of_the_same_round() -> None:
    # The machine gets slower from round to round, which does not change the ratios.
    turns = [
        report.Round(
            1e10 / slowness,
            {"pretended": Sample(3300, slowness, 2.0), "torch": Sample(3300, 6.0 * slowness, 2.0)},
        )
        for slowness in (1.0, 2.0, 8.0)
    ]
    cell = report.cell_of(PAPER, turns, [Pretended(PAPER), PretendedPeer(PAPER)], "a BLAS")
    own, peer = cell.results
    assert asdict(own.ratios["torch"]) == {"median": 6.0, "low": 6.0, "high": 6.0}
    assert "torch folded" not in own.ratios
    assert (peer.ratios["torch"].low, peer.ratios["torch"].high) == (1.0, 1.0)
    assert asdict(own.rate) == {"median": 1650.0, "low": 412.5, "high": 3300.0}
    # At best 10¹⁰ operations a second are so many samples.
    best = 1e10 / PAPER.folded_flops
    assert asdict(own.over_bound) == pytest.approx(dict.fromkeys(("median", "low", "high"), best / 3300.0))


class SgemmBenchmark:
    """Rates without measuring."""

    note = "pretended BLAS"

    def __init__(self, task: object) -> None: ...

    def measure(self, seconds: float) -> float:
        return 1e9

    def close(self) -> None: ...


class Absent(trainers.Torch):
    packages: ClassVar[dict[str, str]] = {"no_such_module": "torch"}


@pytest.fixture
def pretended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the measurements, and hide PyTorch."""
    monkeypatch.setattr(rounds, "_PAUSE", 0.0)
    monkeypatch.setattr(diagnoser, "SgemmBenchmark", SgemmBenchmark)
    monkeypatch.setattr(diagnoser, "TRAINERS", (Pretended, Absent))
    monkeypatch.setattr(diagnoser, "collect", lambda *_: Dataset(Path("nowhere"), 33, 111))


@pytest.mark.usefixtures("pretended")
def test_every_cell_is_measured_and_a_missing_pytorch_is_reported_once() -> None:
    messages: list[str] = []
    found = diagnoser.run(minibatches=[64, 256], threads=[1, 2], rounds=2, epochs=3, progress=messages.append)
    cells = [(cell.threads, cell.minibatch) for cell in found.cells]
    assert cells == [(1, 64), (1, 256), (2, 64), (2, 256)]
    assert [cell.results[0].rate.median for cell in found.cells] == [3 * 3300 / 0.5] * 4
    (missing,) = found.missing
    assert (missing.key, missing.install) == ("torch", "pip install torch")
    assert "1 threads, minibatch 256, round 2 of 2: pretended" in messages


@pytest.mark.usefixtures("pretended")
def test_the_text_and_the_json_contain_the_machine_the_task_and_the_results(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["--robot", "ant", "--minibatch", "64", "--threads", "2", "--timesteps", "50"]
    arguments += ["--rollouts", "10", "--epochs", "2", "--rounds", "3", "--seconds", "0.1"]
    main(arguments)
    text = capsys.readouterr().out
    assert f"numpy {np.__version__}" in text
    assert "robot ant: 512-32-256-128-64-33 units on windows of 50 steps x 111 numbers" in text
    assert "3 rounds of 2 epochs of 330 samples" in text
    (row,) = [line.split() for line in text.splitlines() if line.startswith("pretended  ") and "64" in line]
    assert row[:4] == ["pretended", "2", "64", "1,320"]
    assert "pretended, 2 threads, minibatch 64: version 7" in text
    assert "not measured: torch: torch is not installed; to install it: pip install torch" in text
    assert text.endswith("sgemm: pretended BLAS\n")
    main([*arguments, "--json"])
    whole = json.loads(capsys.readouterr().out)
    assert whole["machine"]["numpy"] == np.__version__
    assert whole["settings"]["hidden"] == [256, 128, 64]
    assert (whole["settings"]["robot"], whole["settings"]["samples"]) == ("ant", 330)
    (cell,) = whole["cells"]
    assert (cell["threads"], cell["minibatch"], cell["sgemm"]["median"]) == (2, 64, 1e9)
    assert cell["results"][0]["rate"] == {"median": 1320.0, "low": 1320.0, "high": 1320.0}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"minibatches": [64, 0]}, "minibatch must be at least 1, got 0"),
        ({"minibatches": []}, "minibatch must be at least 1, got nothing"),
        ({"threads": [0]}, "threads must be at least 1"),
        ({"timesteps": 0}, "timesteps must be at least 1"),
        ({"rollouts": 0}, "rollouts must be at least 1"),
        ({"epochs": 0}, "epochs must be at least 1"),
        ({"rounds": 0}, "rounds must be at least 1"),
        ({"seconds": 0.0}, "seconds must be above 0"),
        ({"robot": "unicorn"}, "unknown robot"),
    ],
)
def test_invalid_arguments_are_rejected_by_name(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        diagnoser.run(**arguments)


def test_a_failed_training_or_collection_is_an_error_with_its_reason(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=r"(?s)ours: .*dataset\.json"):
        trainers.Ours(replace(PAPER, data=str(tmp_path / "nothing"))).train(1)
    with pytest.raises(SimulationError, match=r"(?s)the dataset cannot be collected: .*unicorn"):
        collect("unicorn", 2, 5, 1, tmp_path)


def test_the_fastest_of_several_choices_is_applied(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, chosen = [0.0], ["b"]
    seconds = {"a": 3.0, "b": 1.0, "c": 2.0}

    def work() -> None:
        clock[0] += seconds[chosen[0]]

    monkeypatch.setattr("time.perf_counter", lambda: clock[0])
    best, found = fastest(["a", "b", "c"], lambda choice: chosen.__setitem__(0, choice), work)
    assert (best, chosen) == ("b", ["b"])
    assert found == {"a": 3.0, "b": 1.0, "c": 2.0}


def test_ours_trains_on_every_sample_but_those_of_one_rollout(task: Task) -> None:
    sample = trainers.Ours(task).train(2)
    assert sample.samples == 2 * task.samples
    assert sample.seconds > 0.0
    assert 1.0 < sample.loss < 5.0  # that of guessing is ln 33 = 3.5


NETWORKS = [torch_network.Network, torch_network.FoldedNetwork]


@pytest.mark.slow
@pytest.mark.interop
@pytest.mark.parametrize("kind", NETWORKS)
def test_both_networks_have_the_same_parameters_and_on_the_same_weights_the_same_loss(
    kind: type[torch_network.Network], task: Task, trained: Path
) -> None:
    torch: Any = pytest.importorskip("torch")
    ours, network, program = weights(trained), kind(task), torch_network.TorchDiagnoser(task)
    second_bias = 4 * task.lstm  # PyTorch adds two biases to the gates
    count = sum(parameter.numel() for parameter in network.parameters())
    assert count == sum(tensor.size for tensor in ours.values()) + second_bias

    layers = [layer for layer in network.dense if isinstance(layer, torch.nn.Linear)]
    names = [*(f"hidden.{index}" for index in range(3)), "head"]
    copies = {network.embedding.weight: ours["lstm.embedding.weight"].T}
    copies |= {network.embedding.bias: ours["lstm.embedding.bias"]}
    copies |= {network.lstm.weight_ih_l0: ours["lstm.input.weight"].T}
    copies |= {network.lstm.bias_ih_l0: ours["lstm.input.bias"]}
    copies |= {network.lstm.weight_hh_l0: ours["lstm.recurrent"].T}
    copies |= {network.lstm.bias_hh_l0: np.zeros(second_bias, np.float32)}
    for layer, name in zip(layers, names, strict=True):
        copies |= {layer.weight: ours[f"{name}.weight"].T, layer.bias: ours[f"{name}.bias"]}
    assert set(copies) == set(network.parameters())
    with torch.no_grad():
        for parameter, values in copies.items():
            parameter.copy_(torch.from_numpy(values.copy()))
    network.dense.eval()

    standardizer = tomllib.loads((trained / "model" / "diagnoser.toml").read_text())["description"]
    windows = program._windows
    windows.mean = np.array(standardizer["standardizer"]["mean"], np.float32)
    windows.scale = np.array(standardizer["standardizer"]["scale"], np.float32)
    out, _ = dappo_batch("diagnose", "test", trained, "--data", task.data, "--json")
    ((tested,), samples) = json.loads(out), np.arange((ROLLOUTS + 1) * task.classes)
    assert program.loss(network, samples).item() == pytest.approx(tested["summary"]["log_loss"], rel=1e-4)


@pytest.mark.slow
@pytest.mark.interop
def test_pytorch_counts_the_same_operations(task: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    torch: Any = pytest.importorskip("torch")
    counter = pytest.importorskip("torch.utils.flop_counter")
    program, rows = torch_network.TorchDiagnoser(task), task.samples // task.steps
    monkeypatch.setattr(torch.backends.mkldnn, "enabled", False)  # operations in oneDNN are not counted
    found = []
    for kind in NETWORKS:
        with counter.FlopCounterMode(display=False) as counted:
            program.loss(kind(task), np.arange(rows)).backward()
        found.append(counted.get_total_flops())
    # PyTorch also multiplies the zeros before the first step, but does not count the folded bias.
    first = rows * 2 * product(1, task.lstm, 4 * task.lstm)
    bias = 3 * product(1, task.embedding, 4 * task.lstm)
    expected = [rows * task.plain_flops + first, rows * task.folded_flops + first - bias]
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
@pytest.mark.interop
@pytest.mark.parametrize("kind", [trainers.Torch, trainers.TorchFolded])
def test_pytorch_trains_on_as_many_samples_and_learns(kind: type[trainers.Torch], task: Task) -> None:
    pytest.importorskip("torch")
    trainer = kind(task)
    assert "oneDNN, the faster setting" in trainer.note
    first, later = trainer.train(1), trainer.train(20)
    assert (first.samples, later.samples) == (task.samples, 20 * task.samples)
    assert later.loss < first.loss < 5.0
    trainer.close()
