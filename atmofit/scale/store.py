"""A chunked store on disk that is filled block by block, and knows which blocks are whole.

A store is a folder: `values.zarr` with the arrays, one chunk for each block of rows;
`manifest.json`, which says what they depend on; and `blocks`, with a small file for each block that
is whole, renamed into place after its values were written. The folder itself is made under another
name and renamed, so that a kill at any moment leaves either no store or one that can be filled.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from atmofit.files import output_folder, replace_file
from atmofit.provenance import source_digest, versions
from atmofit.scale.works import Work

if TYPE_CHECKING:
    import xarray

VALUES, MANIFEST, ENTRIES = "values.zarr", "manifest.json", "blocks"
_MADE_OF = ("work", "settings", "versions", "source", "rows", "rows_per_block", "variables")
Values = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class BlockStore:
    """A store that exists; made by `create_store`, or found by `BlockStore.open`.

    Attributes:
        folder: Of the store.
        manifest: What its numbers depend on, and when all is done the checksums.
    """

    folder: Path
    manifest: dict[str, Any]

    @staticmethod
    def open(folder: str | Path) -> "BlockStore":
        """The store in a folder.

        Raises:
            ValueError: There is none.
        """
        path = Path(folder)
        try:
            manifest = json.loads((path / MANIFEST).read_text("utf-8"))
            missing = [name for name in _MADE_OF if name not in manifest]
            if missing:
                raise KeyError(", ".join(missing))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"folder must hold a store of blocks, got {str(path)!r} ({error})"
            ) from error
        return BlockStore(path, manifest)

    @property
    def block_count(self) -> int:
        """Blocks, written or not."""
        return -(-self.manifest["rows"] // self.manifest["rows_per_block"])

    @property
    def key(self) -> str:
        """Hash of all on which the numbers depend."""
        made_of = {name: self.manifest[name] for name in _MADE_OF}
        return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()

    def rows(self, block: int) -> tuple[int, int]:
        """First row of a block, and the one after its last."""
        size = self.manifest["rows_per_block"]
        return block * size, min((block + 1) * size, self.manifest["rows"])

    def entry(self, block: int) -> Path:
        """The file that says that a block is whole."""
        return self.folder / ENTRIES / f"{block:08d}.json"

    def read(self, block: int) -> dict[str, np.ndarray]:
        """The values of a block as they are on disk."""
        import zarr

        group = zarr.open_group(self.folder / VALUES, mode="r")
        first, last = self.rows(block)
        return {name: np.asarray(_array(group, name)[first:last]) for name in self._names}

    def write(self, block: int, values: Values) -> None:
        """Write the values of a block, then the file that says so.

        Raises:
            OSError: They cannot be written; the block is not whole then.
        """
        self.entry(block).unlink(missing_ok=True)
        self._write_values(block, values)
        self._write_entry(block, values)

    def checksum(self, block: int) -> str | None:
        """SHA-256 of a whole block; None if it was not written, or is not what was written."""
        try:
            said = json.loads(self.entry(block).read_text("utf-8"))["sha256"]
            found = self._digest(block, self.read(block))
        except FileNotFoundError:
            return None
        except Exception:  # whatever a damaged chunk makes its decoder say
            return None
        return said if said == found else None

    def absent(self) -> bool:
        """Whether a block was never written."""
        return not all(self.entry(block).exists() for block in range(self.block_count))

    def finish(self) -> "BlockStore":
        """Write the checksums of all blocks into the manifest; they must be whole.

        Raises:
            ValueError: A block is not there.
        """
        try:
            sums = [json.loads(self.entry(k).read_text("utf-8")) for k in range(self.block_count)]
        except FileNotFoundError as error:
            raise ValueError(f"every block must be whole, got none at {error.filename}") from error
        manifest = self.manifest | {"sha256": [entry["sha256"] for entry in sums]}
        if manifest != self.manifest:
            _write_json(self.folder / MANIFEST, manifest)
        return BlockStore(self.folder, manifest)

    def dataset(self) -> "xarray.Dataset":
        """All arrays as an xarray dataset that reads from disk what is used."""
        import xarray

        return xarray.open_dataset(
            self.folder / VALUES, engine="zarr", consolidated=False, chunks=None
        )

    @property
    def _names(self) -> list[str]:
        return sorted(self.manifest["variables"])

    def _write_values(self, block: int, values: Values) -> None:
        import zarr

        group = zarr.open_group(self.folder / VALUES, mode="r+")
        first, last = self.rows(block)
        for name in self._names:
            _array(group, name)[first:last] = values[name]

    def _write_entry(self, block: int, values: Values) -> None:
        first, last = self.rows(block)
        entry = {"rows": [first, last], "sha256": self._digest(block, values)}
        _write_json(self.entry(block), entry)

    def _digest(self, block: int, values: Values) -> str:
        """Of the values, the block's place and what they depend on."""
        digest = hashlib.sha256(f"{self.key} {block}\n".encode())
        for name in self._names:
            array = np.ascontiguousarray(values[name])
            digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
            digest.update(array.tobytes())
        return digest.hexdigest()


def create_store(folder: str | Path, work: Work, rows_per_block: int, first: bool) -> None:
    """Make the store of a work, if it is not there; what an earlier run wrote stays.

    Args:
        folder: Of the store.
        work: What it will hold.
        rows_per_block: At least 1.
        first: Whether this process makes it; the others return at once.

    Raises:
        ValueError: Rows per block below 1, or a folder that cannot be written or holds other
            things.
    """
    path = Path(folder)
    if rows_per_block < 1:
        raise ValueError(f"block must be at least 1, got {rows_per_block}")
    if not first or (path / MANIFEST).is_file():
        return
    if path.is_dir() and any(path.iterdir()):
        raise ValueError(f"out must be a new folder or a store of blocks, got {str(path)!r}")
    output_folder(path.parent)
    new = path.with_name(f".{path.name}.new")
    shutil.rmtree(new, ignore_errors=True)  # of a run that was killed here
    (new / ENTRIES).mkdir(parents=True)
    _write_template(new / VALUES, work, rows_per_block)
    _write_json(new / MANIFEST, _made_of(work, rows_per_block))
    new.replace(path)


def open_for(folder: str | Path, work: Work, rows_per_block: int | None) -> BlockStore:
    """The store of a work, of so many rows per block if a number is given.

    Raises:
        ValueError: It is absent, or holds the numbers of another work; the message names what
            differs.
    """
    store = BlockStore.open(folder)
    asked = _made_of(work, rows_per_block or store.manifest["rows_per_block"])
    differing = [name for name in _MADE_OF if store.manifest[name] != asked[name]]
    if "settings" in differing and isinstance(store.manifest["settings"], dict):
        old, new = store.manifest["settings"], asked["settings"]
        names = sorted(k for k in old.keys() | new.keys() if old.get(k) != new.get(k))
        differing[differing.index("settings")] = f"settings {', '.join(names)}"
    if differing:
        raise ValueError(
            f"out must be a new folder, got {str(folder)!r}, whose store was made with other "
            f"{'; '.join(differing)}"
        )
    return store


def verify_store(folder: str | Path) -> list[int]:
    """Compare every block of a store with its checksum.

    Args:
        folder: Of the store.

    Returns:
        The blocks that are absent or not what was written; none if all is well.

    Raises:
        ValueError: There is no store.
    """
    store = BlockStore.open(folder)
    told = store.manifest.get("sha256")
    sums = [store.checksum(block) for block in range(store.block_count)]
    return [k for k, s in enumerate(sums) if s is None or (told is not None and s != told[k])]


def _made_of(work: Work, rows_per_block: int) -> dict[str, Any]:
    """What the numbers of a store depend on, as JSON gives it back."""
    made_of = {
        "work": work.name,
        "settings": work.settings,
        "versions": versions(),
        "source": source_digest(),
        "rows": work.count,
        "rows_per_block": rows_per_block,
        "variables": {name: variable._asdict() for name, variable in work.variables.items()},
    }
    return json.loads(json.dumps(made_of))


def _write_template(path: Path, work: Work, rows_per_block: int) -> None:
    """Coordinates, and arrays without values; a chunk that is absent reads as NaN, 0 or False."""
    import xarray
    import zarr

    known = xarray.Dataset(coords=dict(work.coordinates), attrs={"title": f"atmofit {work.name}"})
    known.to_zarr(path, mode="w", zarr_format=3, consolidated=False)
    group = zarr.open_group(path, mode="r+")
    for name, variable in work.variables.items():
        dtype = np.dtype(variable.dtype)
        group.create_array(
            name,
            shape=(work.count, *variable.shape),
            chunks=(min(rows_per_block, work.count), *variable.shape),
            dtype=dtype,
            fill_value=np.nan if dtype.kind == "f" else dtype.type(0),
            dimension_names=(work.axis, *variable.dimensions),
            attributes={
                "units": variable.unit,
                "long_name": variable.long_name,
                "coordinates": " ".join(
                    key for key, (axes, *_) in work.coordinates.items() if axes != (key,)
                ),
            },
        )


def _array(group: Any, name: str) -> Any:
    """An array of a zarr group."""
    return group[name]


def _write_json(path: Path, content: Any) -> None:
    text = json.dumps(content, indent=1, sort_keys=True) + "\n"

    def write(temporary: Path) -> None:
        temporary.write_text(text, "utf-8")

    replace_file(path, write)
