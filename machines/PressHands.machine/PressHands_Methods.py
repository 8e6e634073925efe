def both() -> bool:
    """Return whether both buttons are pressed."""
    return hands.left and hands.right


def none() -> bool:
    """Return whether no button is pressed."""
    return not hands.left and not hands.right
