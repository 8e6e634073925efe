"""What machines learn and do, entry by entry."""
