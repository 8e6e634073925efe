"""A live page of a whiteboard and its machines, in the browser."""
