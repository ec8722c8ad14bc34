"""Recorded encounters: tables of events and their readers."""

from crashrate.events.reading import INVALID_SHARE, invalid_share, read_events
from crashrate.events.table import EventTable

__all__ = ["INVALID_SHARE", "EventTable", "invalid_share", "read_events"]
