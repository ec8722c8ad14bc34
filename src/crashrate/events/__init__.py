"""Recorded encounters: tables of events and their readers."""

from crashrate.events.reading import read_events
from crashrate.events.table import EventTable

__all__ = ["EventTable", "read_events"]
