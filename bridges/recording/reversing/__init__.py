"""Steps a recorded run back: reverse debugging."""
