"""Journals: all that machines learn and do, entry by entry."""
