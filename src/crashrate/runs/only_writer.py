"""One process at a time writes to a run folder, and others are told before they simulate."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from crashrate.errors import StoreError
from crashrate.runs.store import make_folder, read_only

LOCK = "campaign.lock"
PATIENCE = 1.0  # seconds: whoever only asks whether a run goes on holds the lock for an instant


@contextmanager
def only_writer(directory: Path) -> Iterator[None]:
    """Be the only one to write to `directory`, which is made where it is missing.

    A folder made in vain, because nothing was written to it, is taken away again. The operating
    system lets go of the lock when its process ends, however it ends.

    Raises
    ------
    StoreError
        If another process writes to the folder, or nobody can.
    """
    from filelock import FileLock, Timeout

    made = make_folder(directory)
    lock = FileLock(directory / LOCK, timeout=PATIENCE)
    try:
        lock.acquire()
    except Timeout:
        raise StoreError(
            f"{directory}: another process runs in this folder now; wait for it, or choose another "
            "--out."
        ) from None
    except NotImplementedError:  # a file system without locks: the store still notices two writers
        pass
    except OSError:
        raise read_only(directory) from None
    try:
        yield
    finally:
        lock.release()
        if made and [path.name for path in directory.iterdir()] in ([], [LOCK]):
            (directory / LOCK).unlink(missing_ok=True)
            directory.rmdir()


def is_being_written(directory: Path) -> bool:
    """Whether a process runs in `directory` now; False where that cannot be told."""
    from filelock import FileLock, Timeout

    if not (directory / LOCK).exists():
        return False
    try:
        with FileLock(directory / LOCK, timeout=0):
            return False
    except Timeout:
        return True
    except (OSError, NotImplementedError):
        return False
