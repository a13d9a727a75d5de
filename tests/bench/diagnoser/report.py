"""The report of a benchmark of the diagnoser's training, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from dappo_batch import machine
from dappo_batch.bench.measure import Spread, align

from .. import rounds
from ..matmul import gflops
from ..rounds import ratios
from .task import Task
from .trainers import Sample, Torch, TorchFolded, Trainer

__all__ = ["PEERS", "Cell", "DiagnoserReport", "Result", "Round", "cell_of"]

PEERS = (Torch.key, TorchFolded.key)
"""Keys of the trainers with which all others are compared, if they were measured."""


Round: TypeAlias = rounds.Round[float, Sample]
"""The machine's rate is in floating-point operations per second, in multiplications of float32 matrices."""


@dataclass(frozen=True)
class Result:
    """The results of one trainer in one cell.

    Attributes
    ----------
    rate : Spread
        Training samples per second.
    loss : Spread
        Mean cross-entropy of the last epoch of a sample.
    ratios : dict
        `rate` divided by that of each measured trainer of `PEERS`, round by round.
    over_bound : Spread
        Time divided by the bound, round by round.
    """

    key: str
    about: str
    note: str
    rate: Spread
    loss: Spread
    ratios: dict[str, Spread]
    over_bound: Spread


@dataclass(frozen=True)
class Cell:
    """The results of all trainers with one number of threads and one size of minibatch.

    Attributes
    ----------
    sgemm : Spread
        Floating-point operations per second in multiplications of float32 matrices.
    sgemm_note : str
        Library and threads of the multiplications.
    folded_flops, plain_flops : float
        Operations of a sample, see `Task`; the former define the bound.
    results : tuple of Result
        The measured trainers.
    """

    threads: int
    minibatch: int
    sgemm: Spread
    sgemm_note: str
    folded_flops: float
    plain_flops: float
    results: tuple[Result, ...]


def cell_of(task: Task, turns: Sequence[Round], trainers: Sequence[Trainer], sgemm_note: str) -> Cell:
    """Summarise the rounds of a task."""
    return Cell(
        threads=task.threads,
        minibatch=task.minibatch,
        sgemm=Spread.of([one.machine for one in turns]),
        sgemm_note=sgemm_note,
        folded_flops=task.folded_flops,
        plain_flops=task.plain_flops,
        results=tuple(_result(task, turns, trainer) for trainer in trainers),
    )


def _result(task: Task, turns: Sequence[Round], trainer: Trainer) -> Result:
    def spread(number: Callable[[Round, Sample], float]) -> Spread:
        return Spread.of([number(one, one.samples[trainer.key]) for one in turns])

    return Result(
        key=trainer.key,
        about=trainer.about,
        note=trainer.note,
        rate=spread(lambda _, own: own.rate),
        loss=spread(lambda _, own: own.loss),
        ratios=ratios(turns, trainer.key, PEERS),
        over_bound=spread(lambda one, own: one.machine / (own.rate * task.folded_flops)),
    )


@dataclass(frozen=True)
class DiagnoserReport(rounds.Report):
    """The report of ``python -m tests.bench.diagnoser``.

    Attributes
    ----------
    cells : tuple of Cell
        The results.
    """

    cells: tuple[Cell, ...]

    def parts(self) -> tuple[str, ...]:
        """Return the paragraphs of the text, the bound last."""
        return self._head(), self._table(), self._legend(), self._bound()

    def _head(self) -> str:
        one = self.settings
        widths = "-".join(map(str, (one["embedding"], one["lstm"], *one["hidden"], one["classes"])))
        return (
            f"{machine.text(self.machine)}\n"
            f"training the diagnoser of robot {one['robot']}: {widths} units on windows of "
            f"{one['timesteps']} steps x {one['inputs']} numbers\n"
            f"{one['rounds']} rounds of {one['epochs']} epochs of {one['samples']} samples, medians (lowest "
            "to highest)"
        )

    def _table(self) -> str:
        peers = [peer for peer in PEERS if peer in self.cells[0].results[0].ratios]
        head = ["", "threads", "minibatch", "samples/s", *(f"speed / {peer}" for peer in peers)]
        rows = [[*head, "loss", "time / bound"]]
        rows += [
            [
                one.key,
                str(cell.threads),
                str(cell.minibatch),
                one.rate.text(",.0f"),
                *(one.ratios[peer].text(".2f") for peer in peers),
                f"{one.loss.median:.2f}",
                one.over_bound.text(".2f"),
            ]
            for cell in self.cells
            for one in cell.results
        ]
        return align(rows)

    def _legend(self) -> str:
        about = {one.key: one.about for cell in self.cells for one in cell.results}
        width = max(map(len, about), default=0)
        lines = [f"{key.ljust(width)}  {text}" for key, text in about.items()]
        lines += [
            f"{one.key}, {cell.threads} threads, minibatch {cell.minibatch}: {one.note}"
            for cell in self.cells
            for one in cell.results
            if one.note
        ]
        return "\n".join(lines)

    def _bound(self) -> str:
        head = ["bound = sgemm / operations", "threads", "minibatch", "sgemm Gflop/s", "samples/s"]
        rows = [[*head, "Mflop a sample", "layer by layer"]]
        rows += [
            [
                "",
                str(cell.threads),
                str(cell.minibatch),
                gflops(cell.sgemm),
                f"{cell.sgemm.median / cell.folded_flops:,.0f}",
                f"{cell.folded_flops / 1e6:.2f}",
                f"{cell.plain_flops / 1e6:.2f}",
            ]
            for cell in self.cells
        ]
        notes = dict.fromkeys(cell.sgemm_note for cell in self.cells)
        return f"{align(rows)}\nsgemm: {'; '.join(notes)}"
