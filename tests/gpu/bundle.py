"""Pack the check of a GPU, with all it needs, for a machine without network: see ``make gpu-bundle``.

A program of the standard library alone, run as a file: the package need not be installed.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILES = ("pyproject.toml", "tests")
"""What travels of the repository."""
DEBS = ("libvulkan1",)
MIB = 1 << 20


def constraints() -> str:
    """Return the versions of ``uv.lock``, without packages whose version depends on that of Python."""
    versions = defaultdict(set)
    for package in tomllib.loads((ROOT / "uv.lock").read_text())["package"]:
        if "version" in package:
            versions[package["name"]].add(package["version"])
    return "\n".join(f"{name}=={min(found)}" for name, found in versions.items() if len(found) == 1)


def download_wheels(wheel: Path, python: str, folder: Path) -> None:
    """Download the wheels of the package with its extra ``gpu``, of pytest, and of pip to install them."""
    platforms = ["manylinux2014_x86_64", *(f"manylinux_2_{minor}_x86_64" for minor in range(17, 40))]
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--only-binary=:all:"]
    command += ["--python-version", python, "--implementation", "cp", "--dest", str(folder)]
    command += [flag for platform in ("linux_x86_64", *platforms) for flag in ("--platform", platform)]
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        file.write(constraints())
        file.flush()
        command += ["--constraint", file.name, f"{wheel}[gpu]", "pytest", "pip"]
        subprocess.run(command, check=True)


def download_debs(folder: Path) -> None:
    """Download Vulkan's loader, which images for CUDA often lack."""
    folder.mkdir()
    try:
        subprocess.run(["apt-get", "download", "--quiet", *DEBS], cwd=folder, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"without {' and '.join(DEBS)}, which the machine must then have: {error}", file=sys.stderr)


def copy_files(folder: Path) -> None:
    """Copy what git has of the check."""
    listed = subprocess.run(["git", "ls-files", "-z", *FILES], cwd=ROOT, check=True, capture_output=True)
    for name in listed.stdout.decode().split("\0")[:-1]:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)


def split(path: Path, out: Path, size: int) -> list[Path]:
    """Split a file into parts of at most `size` bytes, each in a folder of its own."""
    parts: list[Path] = []
    with path.open("rb") as file:
        while data := file.read(size):
            part = out / f"part{len(parts):02}"
            part.mkdir(parents=True)
            (part / f"bundle.{len(parts):02}").write_bytes(data)
            parts.append(part)
    return parts


def main() -> None:
    """Write the parts and print their sizes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path, help="the package, built with the feature gpu")
    parser.add_argument("--out", type=Path, default=ROOT / ".gpu", help="folder of the parts")
    parser.add_argument("--part-mib", type=int, default=60, help="most that a part takes, MiB")
    parser.add_argument("--python", default="3.12", help="Python of the machine")
    arguments = parser.parse_args()
    for part in arguments.out.glob("part*"):
        shutil.rmtree(part)
    with tempfile.TemporaryDirectory() as scratch:
        folder, archive = Path(scratch, "bundle"), Path(scratch, "bundle.tar")
        (folder / "wheels").mkdir(parents=True)
        download_wheels(arguments.wheel.resolve(), arguments.python, folder / "wheels")
        download_debs(folder / "debs")
        copy_files(folder)
        with tarfile.open(archive, "w") as tar:
            tar.add(folder, "bundle")
        script = ROOT / "tests/gpu/run.sh"
        parts = split(archive, arguments.out, arguments.part_mib * MIB - script.stat().st_size)
        shutil.copy(script, parts[-1])
    for part in parts:
        print(f"{part}: {sum(file.stat().st_size for file in part.iterdir()) / MIB:.1f} MiB")
    print(f"on the machine, with all parts in the folder PARTS: bash PARTS/{parts[-1].name}/run.sh PARTS OUT")


if __name__ == "__main__":
    main()
