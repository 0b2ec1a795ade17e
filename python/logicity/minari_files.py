"""Episodes in the files of Minari datasets.

Only observations and actions are read, as numbers, and what a file claims is checked before it takes memory.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from .errors import extra
from .files import check_readable
from .terminal import first_line

if TYPE_CHECKING:
    from minari import MinariDataset

__all__ = ["StoredEpisode", "load_minari", "stored_episodes"]

#: The maximum number of bytes of the values of a Minari dataset. `induce` copies its observations into one array.
BYTES_MAX = 2 << 30


@dataclass(frozen=True)
class StoredEpisode:
    """An episode that was read from a file."""

    observations: NDArray[Any]
    actions: NDArray[Any]


def load_minari(name: str | os.PathLike[str]) -> MinariDataset:
    """Load a Minari dataset, given its name or its folder."""
    path = Path(name)
    folder = next((folder for folder in (path / "data", path) if (folder / "metadata.json").is_file()), None)
    if folder is None and (path.exists() or not isinstance(name, str)):
        raise FileNotFoundError(f"neither a Parquet table nor a Minari dataset: `{name}`")
    with extra("offline"):
        from minari import MinariDataset
        from minari.dataset.minari_storage import MinariStorage
        from minari.storage import get_dataset_path

    if folder is None:
        folder = Path(get_dataset_path(os.fspath(name))) / "data"
        if not folder.exists():
            message = f"neither a file nor a dataset of Minari on this machine: `{name}`"
            raise FileNotFoundError(f"{message}; `minari download {name}` downloads a published one")
    with _reading(name):
        check_readable(folder / "metadata.json")
        described = MinariStorage.read_raw_metadata(folder)
        if not {"observation_space", "action_space"} <= described.keys():
            # Minari would make the environment to see its spaces, which calls any function that the file names.
            raise ValueError("its `metadata.json` lacks `observation_space` or `action_space`")
        storage = MinariStorage.read(folder)
        # Minari numbers the claimed episodes at once.
        if not 0 <= storage.total_episodes <= (count := _count(storage)):
            raise ValueError(f"it claims {storage.total_episodes} episodes, and has {count}")
        return MinariDataset(storage)


def _count(storage: Any) -> int:
    if storage.FORMAT != "hdf5":
        return sum(folder.name.isdecimal() for folder in Path(storage.data_path).iterdir())
    import h5py

    with h5py.File(_hdf5_file(storage)) as content:
        return len(content)


def _hdf5_file(storage: Any) -> Path:
    file = Path(storage.data_path) / "main_data.hdf5"
    check_readable(file, whole=False)
    return file


def _stored_in_hdf5(storage: Any, indices: Sequence[int]) -> Iterator[StoredEpisode]:
    import h5py

    read = 0
    with h5py.File(_hdf5_file(storage)) as content:
        for index in indices:
            arrays = []
            for name in ("observations", "actions"):
                place = f"episode_{index}/{name}"
                for part in (f"episode_{index}", place):
                    if not isinstance(content.get(part, getlink=True), h5py.HardLink):
                        raise ValueError(f"`{part}` is a link")
                values = content[place]
                if not isinstance(values, h5py.Dataset) or values.dtype.kind not in "biuf":
                    raise ValueError(f"`{place}` has no numbers")
                if values.external or values.is_virtual:
                    raise ValueError(f"`{place}` has its values in another file")
                # A dataset without stored values takes no bytes of the file, and several may be the same.
                read += values.nbytes
                _check_bytes(read)
                arrays.append(values[()])
            yield StoredEpisode(*arrays)


def _stored_in_tables(storage: Any, indices: Sequence[int]) -> Iterator[StoredEpisode]:
    import pyarrow
    import pyarrow.parquet

    read = 0
    for index in indices:
        files = sorted((Path(storage.data_path) / str(index)).glob(f"*.{storage.FORMAT}"))
        if len(files) != 1:
            raise ValueError(f"episode {index} has {len(files)} files, not one")
        (file,) = files
        check_readable(file, whole=False)
        if storage.FORMAT == "parquet":
            parquet = pyarrow.parquet.ParquetFile(file)
            schema, rows, read_columns = parquet.schema_arrow, parquet.metadata.num_rows, parquet.read
        else:
            arrow = _uncompressed(file)
            schema, rows, read_columns = arrow.schema, arrow.num_rows, arrow.select
        observation, action = (schema.field(name).type for name in ("observations", "actions"))
        is_list = pyarrow.types.is_fixed_size_list(observation)
        number = observation.value_type if is_list else observation
        if not (pyarrow.types.is_integer(number) or pyarrow.types.is_floating(number)):
            raise ValueError(f"the observations of episode {index} have the type {observation}, not numbers")
        if not pyarrow.types.is_integer(action):
            raise ValueError(f"the actions of episode {index} have the type {action}, not integers")
        width = observation.list_size if is_list else 1
        read += rows * (width * number.bit_width + action.bit_width) // 8
        _check_bytes(read)
        columns = ["observations", "actions"]
        table = read_columns(columns)
        table.validate()
        observations, actions = (table[name].combine_chunks() for name in columns)
        values = observations.flatten() if is_list else observations
        if observations.null_count + values.null_count + actions[:-1].null_count > 0:
            raise ValueError(f"episode {index} lacks values")
        # The last observation has no action; Minari writes 0 there.
        yield StoredEpisode(values.to_numpy(zero_copy_only=False).reshape(-1, width), actions[:-1].to_numpy())


def _check_bytes(read: int) -> None:
    if read > BYTES_MAX:
        raise ValueError(f"its values take more than {BYTES_MAX >> 20} MiB")


def _uncompressed(file: Path) -> Any:
    """Return the table in an Arrow file without compressed values and dictionaries, which take more memory."""
    import pyarrow

    def place(metadata: bytes, table: int, number: int) -> int | None:
        """Return the place of a field in a table of FlatBuffers; `None` if the table lacks the field."""
        vtable = table - struct.unpack_from("<i", metadata, table)[0]
        position = 4 + 2 * number
        within = position < struct.unpack_from("<H", metadata, vtable)[0]
        offset = struct.unpack_from("<H", metadata, vtable + position)[0] if within else 0
        return table + offset if offset else None

    # After eight bytes, the file format is the stream format. The footer may name other places, and is not read.
    begin = 8
    with pyarrow.memory_map(str(file)) as content:
        content.seek(begin)
        for message in pyarrow.ipc.MessageReader.open_stream(content):
            if message.type == "dictionary":
                raise ValueError(f"`{file.name}` has a dictionary")
            metadata = message.metadata.to_pybytes()
            try:
                # The header is field 2 of a message, and the compression field 3 of the header of a record batch.
                header = place(metadata, struct.unpack_from("<I", metadata)[0], 2)
                if message.type == "record batch" and header is not None:
                    batch = header + struct.unpack_from("<I", metadata, header)[0]
                    if place(metadata, batch, 3) is not None:
                        raise ValueError(f"`{file.name}` is compressed")
            except struct.error:
                raise ValueError(f"`{file.name}` is damaged") from None
        content.seek(begin)
        return pyarrow.ipc.open_stream(content).read_all()


def stored_episodes(dataset: MinariDataset) -> Iterator[StoredEpisode]:
    """Yield the episodes of a Minari dataset.

    Raises:
        ValueError: If its files are damaged, have values that are not numbers, or take too much memory.
    """
    with _reading(dataset.id):
        # Reads only observations and actions: what a file says about other values may take any memory.
        read = _stored_in_hdf5 if dataset.storage.FORMAT == "hdf5" else _stored_in_tables
        yield from read(dataset.storage, [int(index) for index in dataset.episode_indices])


@contextmanager
def _reading(name: object) -> Iterator[None]:
    """Name the Minari dataset in the exceptions of its reader."""
    try:
        yield
    except (FileNotFoundError, MemoryError):
        raise
    except Exception as error:
        reason = first_line(str(error), type(error).__name__)
        raise ValueError(f"cannot read the Minari dataset `{name}`: {reason}") from error
