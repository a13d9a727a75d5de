"""The valid files from which inputs are generated, and the temporary folder of a case."""

from __future__ import annotations

import json
import os
import shutil
import signal
import zlib
from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from dappo_batch import ClassTable
from dappo_batch._core import run_cli

ROBOT = Path(__file__).parents[2] / "python" / "robots"

TINY = (
    *("--threads", "1", "--envs", "2", "--steps", "16", "--set", "horizon=8", "ppo.hidden=[4]"),
    *("env.max_episode_steps=6", "evaluation.episodes=1", "damage.max_damaged_limbs=1", "checkpoint.every=1"),
    "checkpoint.keep=1",
)
WINDOWS = ("--preset", "residual", "--rollouts", "4", "--timesteps", "3", "--onset", "0-2", "--delay", "0-1")
NETWORK = ("epochs=1", "embedding=3", "lstm=3", "hidden=[3]")

COMMANDS: tuple[tuple[str, ...], ...] = (
    ("train", "--robot", "robot/tripod.toml", *TINY, "--run", "run"),
    ("diagnose", "collect", "run", *WINDOWS, "--threads", "1", "--out", "pairs"),
    ("diagnose", "train", "pairs", "--threads", "1", "--out", "diagnoser", "--set", *NETWORK),
    ("export", "run", "--diagnoser", "diagnoser", "--out", "export"),
    (
        *("adapt", "run", "--diagnoser", "diagnoser", "--damage", "missing_toe@0", "--at", "2"),
        *("--episodes", "1", "--threads", "1", "--log", "trace.csv"),
    ),
)
"""Commands that create the valid folders, with minimal sizes."""


class BadExit(Exception):
    """The command line exited with an undocumented code."""


def prepare(base: Path) -> None:
    """Make the valid files, in about a second."""
    (base / "robot").mkdir(parents=True)
    shutil.copy(ROBOT / "tripod.toml", base / "robot")
    # With a box, which the lane engine knows, too.
    mjcf = (ROBOT / "tripod.xml").read_text()
    box = mjcf.replace('type="cylinder" size="0.12 0.02"', 'type="box" size="0.1 0.1 0.02"')
    assert box != mjcf, "the tripod has another plate"
    (base / "robot" / "tripod.xml").write_text(box)
    before = Path.cwd()
    os.chdir(base)
    try:
        for command in COMMANDS:
            code = run_cli(list(command))
            assert code == 0, (command, code)
    finally:
        os.chdir(before)


class Room:
    """A folder of copies, emptied after each case.

    Attributes
    ----------
    base : Path
        The valid files.
    folder : Path
        Where the case works. It lies two levels below what is emptied, as a case may write to ``..``.
    notes : list of str
        The calls of the case, for the report of a fault.
    codes : list of int
        Exit codes of its command lines.
    """

    def __init__(self, base: Path, root: Path) -> None:
        self.base = base
        self.root = root
        self.folder = root / "a" / "room"
        self.notes: list[str] = []
        self.codes: list[int] = []
        self.clear()

    def clear(self) -> None:
        """Clear the folder of the last case."""
        self.notes.clear()
        self.codes.clear()
        shutil.rmtree(self.root, ignore_errors=True)
        self.folder.mkdir(parents=True)
        os.chdir(self.folder)

    def copy(self, *names: str) -> Path:
        """Copy valid files or folders to here; return the first copy."""
        for name in names:
            target = self.folder / name
            if (self.base / name).is_dir():
                shutil.copytree(self.base / name, target, dirs_exist_ok=True)
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(self.base / name, target)
        return self.folder / names[0]

    def call(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:  # noqa: ANN401
        """Call a function, and record the call."""
        shown = [*map(_shown, arguments), *(f"{name}={_shown(value)}" for name, value in options.items())]
        self.notes.append(f"{getattr(function, '__qualname__', function)}({', '.join(shown)})")
        return function(*arguments, **options)

    def command(self, argv: Sequence[str]) -> None:
        """Run a command line as the terminal does."""
        self._note_code(self.call(run_cli, list(argv)))

    def stopped_command(self, argv: Sequence[str]) -> None:
        """Run a command line in a separate process, and send Ctrl-C as soon as it prints something."""
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            os.dup2(writer, 1)
            code = 130
            try:
                code = run_cli(list(argv))
            except KeyboardInterrupt:
                pass  # Ctrl-C after the command has checked for it the last time
            finally:
                # Nothing of the test process may run on in its copy.
                os._exit(code)
        self.notes.append(f"a process: run_cli({list(argv)!r})")
        os.close(writer)
        with open(reader, "rb") as output:
            if output.read(1):
                os.kill(child, signal.SIGINT)
            while output.read(2**16):
                pass
        _, status = os.waitpid(child, 0)
        self._note_code(os.waitstatus_to_exitcode(status))

    def _note_code(self, code: int) -> None:
        self.codes.append(code)
        if code not in (0, 1, 2, 130):
            raise BadExit(f"exit code {code}")


def _shown(value: object) -> str:
    if isinstance(value, ClassTable):
        return f"<the classes of {value.robot.path}>"
    try:
        return repr(value)[:2000]
    except Exception as error:  # whatever an odd object does
        return f"<{type(value).__name__}: {error}>"


def sign(folder: Path) -> None:
    """Update lengths and checksums, so that readers accept the changed files."""
    for path in _files(folder, "manifest.json"):
        _sign_list(path, "files", lambda data: {"bytes": len(data), "crc32": zlib.crc32(data)})
    for path in (*_files(folder, "export.json"), *_files(folder, "robot.json")):
        _sign_list(path, "files", lambda data: {"bytes": len(data), "sha256": sha256(data).hexdigest()})
    for path in _files(folder, "diagnoser.toml"):
        weights = path.with_name("weights.bpk")
        if weights.is_file():
            _replace_entry(path, "weights_crc32", f'"{zlib.crc32(weights.read_bytes()):08x}"')


def _files(folder: Path, name: str) -> Iterator[Path]:
    """Yield the regular files of a name below a folder."""
    return (path for path in folder.rglob(name) if path.is_file())


def _sign_list(path: Path, key: str, describe: Callable[[bytes], dict[str, Any]]) -> None:
    try:
        manifest = json.loads(path.read_text())
        entries = manifest[key]
        pairs = (
            entries.items() if isinstance(entries, dict) else [(entry["name"], entry) for entry in entries]
        )
        for name, entry in pairs:
            file = path.parent / name
            if file.is_file():
                entry.update(describe(file.read_bytes()))
        path.write_text(json.dumps(manifest))
    except (ValueError, KeyError, TypeError, AttributeError, OSError):
        return  # the list itself was changed beyond reading


def _replace_entry(path: Path, key: str, value: str) -> None:
    try:
        lines = path.read_text().split("\n")
    except (UnicodeDecodeError, OSError):
        return
    path.write_text("\n".join(f"{key} = {value}" if line.startswith(f"{key} =") else line for line in lines))
