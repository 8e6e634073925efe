"""A page in the browser on which a whiteboard and its machines are alive."""
