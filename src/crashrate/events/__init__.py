"""Recorded encounters: tables of events and their readers."""
