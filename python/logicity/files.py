"""Files: atomic writes, which protect the files of other programs, and tensors that are plain data."""

from __future__ import annotations

import hashlib
import json
import os
import stat
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

from . import _logicity
from .errors import checked_path, extra
from .terminal import first_line

__all__ = [
    *("check_readable", "check_writable", "file_hash", "json_text", "read_json", "read_tensors", "read_text"),
    *("reserved", "write_json", "write_safetensors", "write_text"),
]


def check_readable(path: str | os.PathLike[str], *, whole: bool = True, named: bool = False) -> None:
    """Raise `OSError` now if reading a file could block or never end. A file that does not exist passes.

    The file must not be a folder, a device, or below `/proc` or `/sys`. A file that is read as a whole must not be
    larger than 1 GiB. If the caller names the file itself, not its folder, it may be a pipe.
    """
    name = checked_path("path", path)
    # Opening a file that does not exist raises the exception that names it.
    with suppress(FileNotFoundError):
        if not named and stat.S_ISFIFO(os.stat(name).st_mode):
            raise OSError(f"cannot read `{name}`: it is a pipe, not a regular file")
        _logicity.check_readable(name, whole)


def read_json(path: str | os.PathLike[str]) -> Any:
    """Return the value in a file of JSON, as `read_text` reads it. Raise `ValueError` if it is not JSON."""
    try:
        return json.loads(read_text(path))
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a regular file of at most 1 GiB. Raise `ValueError` if it is not UTF-8."""
    check_readable(path)
    return Path(path).read_text(encoding="utf-8")


def file_hash(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a regular file of any size, as hex digits."""
    digest = hashlib.sha256()
    check_readable(path, whole=False)
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


@contextmanager
def reserved(
    path: str | os.PathLike[str], *, by: str | None, overwrite: bool = False
) -> Iterator[_logicity.OutputFile]:
    """Yield an output file that no other process can write in the meantime. It is discarded unless it is finished.

    Its `temporary` file exists already; a writer opens it and writes it in place. `finish` replaces `path` by it. Links
    are followed, and an existing file keeps its permissions.

    Args:
        path: The file.
        by: The command or function that writes. `None` replaces any file, and later commands do not recognize it.
        overwrite: Whether to replace a file that `by` did not write, or that has changed since.

    Raises:
        FileExistsError: If `path` must not be replaced.
        OSError: If the file cannot be written, or another process writes it.
    """
    output = _logicity.OutputFile(checked_path("path", path), overwrite, by)
    try:
        yield output
    finally:
        output.discard()


def check_writable(path: str | os.PathLike[str], *, by: str, overwrite: bool = False) -> None:
    """Raise now if `reserved` would raise later."""
    with reserved(path, by=by, overwrite=overwrite):
        pass


def write_json(path: str | os.PathLike[str], value: Any, *, by: str | None = None, overwrite: bool = False) -> None:
    """Write a value as `write_text` does, in the form of `json_text`."""
    write_text(path, json_text(value), by=by, overwrite=overwrite)


def json_text(value: Any) -> str:
    """Return the content of a file of JSON. Raise `ValueError` for numbers that are not finite."""
    return json.dumps(value, indent=1, allow_nan=False) + "\n"


def write_text(path: str | os.PathLike[str], text: str, *, by: str | None = None, overwrite: bool = False) -> None:
    """Write text to a file, in UTF-8, as `reserved` permits."""
    with reserved(path, by=by, overwrite=overwrite) as output:
        # The same bytes on every system.
        Path(output.temporary).write_text(text, encoding="utf-8", newline="\n")
        output.finish()


def read_tensors(path: str | os.PathLike[str], expected: str) -> Any:
    """Return the content of a file of `torch.save` that has only tensors and plain data. Nothing in it runs as code.

    A file with the suffix `.safetensors` is one that `write_safetensors` wrote.

    Raises:
        ValueError: If PyTorch cannot read it as such. The message says what is expected, such as `a policy`.
    """
    check_readable(path)
    if Path(path).suffix == ".safetensors":
        return _read_safetensors(path, expected)
    import torch

    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                # Stored bytes need no more memory than the file. PyTorch does not compress.
                if any(each.compress_type != zipfile.ZIP_STORED for each in archive.infolist()):
                    raise ValueError("it is compressed")
                # PyTorch does not compare the checksums.
                if archive.testzip() is not None:
                    raise ValueError("a checksum is wrong")
        return torch.load(path, map_location="cpu", weights_only=True)
    except UnpicklingError:
        message = "it may be damaged, or have Python objects, which could run any code when they are loaded"
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise
        # Depending on the bytes, PyTorch raises almost any exception.
        message = "it may be damaged"
    raise ValueError(f"{os.fspath(path)} is not {expected}: PyTorch cannot read it as plain data; {message}")


def write_safetensors(path: str | os.PathLike[str], content: Any) -> None:
    """Write tensors and plain data to a file in the format safetensors, which has the plain data in its metadata.

    Raises:
        ImportError: If safetensors, which the extra `learn` installs, is missing.
        TypeError: If a value is neither a tensor nor plain data.
        ValueError: If two tensors get the same name in the file, as in `{1: a, "1": b}`.
    """
    with extra("learn"):
        import safetensors.torch

    tensors: dict[str, Any] = {}
    metadata = {"format": "pt", _PLAIN: json.dumps(_without_tensors(content, "", tensors))}
    with reserved(path, by=None) as output:
        Path(output.temporary).write_bytes(safetensors.torch.save(tensors, metadata))
        output.finish()


#: The key of the metadata of safetensors that has the plain data.
_PLAIN = "logicity"


def _without_tensors(value: Any, name: str, tensors: dict[str, Any]) -> Any:
    """Return a value as JSON. A tensor, and what JSON lacks, becomes a mapping with one key that begins with `$`."""
    import torch

    if isinstance(value, torch.Tensor):
        # Names of values in lists and mappings, such as `weights.actor.0.bias`.
        if name in tensors:
            raise ValueError(f"two tensors have the name `{name}`: rename a key of their mappings")
        tensors[name] = value.detach().cpu().contiguous().clone()
        return {"$tensor": name}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple)):
        values = [_without_tensors(each, f"{name}.{at}", tensors) for at, each in enumerate(value)]
        return {"$tuple": values} if isinstance(value, tuple) else values
    if isinstance(value, dict):
        within = f"{name}." if name else ""
        items = [(key, _without_tensors(each, f"{within}{key}", tensors)) for key, each in value.items()]
        if all(isinstance(key, str) and not key.startswith("$") for key in value):
            return dict(items)
        return {"$items": [[_without_tensors(key, "", tensors), each] for key, each in items]}
    raise TypeError(f"{name}: {type(value).__name__} is neither a tensor nor plain data")


def _with_tensors(value: Any, tensors: dict[str, Any]) -> Any:
    """Return the value of which `_without_tensors` returned the JSON."""
    if isinstance(value, list):
        return [_with_tensors(each, tensors) for each in value]
    if not isinstance(value, dict):
        return value
    match value:
        case {"$tensor": name}:
            return tensors[name]
        case {"$tuple": values}:
            return tuple(_with_tensors(each, tensors) for each in values)
        case {"$items": items}:
            return {_with_tensors(key, tensors): _with_tensors(each, tensors) for key, each in items}
    return {key: _with_tensors(each, tensors) for key, each in value.items()}


def _read_safetensors(path: str | os.PathLike[str], expected: str) -> Any:
    with extra("learn"):
        import safetensors

    try:
        with safetensors.safe_open(os.fspath(path), framework="pt", device="cpu") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}
        if _PLAIN not in metadata:
            raise ValueError(f"its metadata lacks the key `{_PLAIN}`")
        return _with_tensors(json.loads(metadata[_PLAIN]), tensors)
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise
        # A faulty file raises an exception of safetensors, or one of the types of what it lacks.
        reason = first_line(str(error), type(error).__name__)
    raise ValueError(f"{os.fspath(path)} is not {expected}: {reason}")
