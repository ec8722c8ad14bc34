"""Other tools on the same problems, with their best settings, a margin, an exact transform."""

from importlib import import_module
from importlib.util import find_spec

from peers.limit_state import Answer, LimitState
from peers.peer import Peer

MODULES = {  # and the packages of `pip install -e '.[bench]'` that they need
    "openturns_peers": ("openturns",),
    "pystra_peers": ("pystra",),
    "kriging": ("openturns",),
}


def missing() -> dict[str, str]:
    """Modules that cannot be used here, and the packages they miss."""
    lacks = {
        module: [package for package in packages if find_spec(package) is None]
        for module, packages in MODULES.items()
    }
    return {module: ", ".join(packages) for module, packages in lacks.items() if packages}


def available() -> dict[str, Peer]:
    """The peers whose packages are installed, by name."""
    modules = [import_module(f"peers.{name}") for name in MODULES if name not in missing()]
    return {peer.name: peer for module in modules for peer in module.PEERS}


__all__ = ["MODULES", "Answer", "LimitState", "Peer", "available", "missing"]
