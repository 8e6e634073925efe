def both() -> bool:
    """True if both buttons are pressed."""
    return hands.left and hands.right


def none() -> bool:
    """True if no button is pressed."""
    return not hands.left and not hands.right
