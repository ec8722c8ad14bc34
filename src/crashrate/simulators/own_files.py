"""The files beside a module that it imports, found in the texts and not in what is imported now."""

import ast
from collections.abc import Iterator
from pathlib import Path


def own_files(file: Path, folder: Path) -> list[Path]:
    """`file`, then the files in `folder` that it imports, itself or through others, by name.

    Imports anywhere in a text count; what is not found in the folder is somebody else's.
    """
    found, left = {file}, [file]
    while left:
        new = {f for f in _imported(left.pop(), folder) if f not in found}
        found |= new
        left += sorted(new)
    return [file, *sorted(found - {file})]


def _imported(file: Path, folder: Path) -> Iterator[Path]:
    if file.suffix != ".py":
        return
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return  # importing it fails, and says so
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _files(folder, alias.name)
        elif isinstance(node, ast.ImportFrom):
            base = folder if node.level == 0 else file.parents[node.level - 1]
            for alias in node.names:  # what is imported from a package may be a module of it
                yield from _files(base, ".".join(filter(None, (node.module, alias.name))))


def _files(base: Path, dotted: str) -> Iterator[Path]:
    """The files of a module and of the packages around it, as far as they are in `base`."""
    path = base
    for name in dotted.split("."):
        path /= name
        for file in (path.with_suffix(".py"), path / "__init__.py"):
            if file.is_file():
                yield file
