"""Give machines their turns. Nothing here imports anything else of the runtime but its logger."""
