"""Colours and sizes of pictures, the same in every format. Sizes are in units of the picture."""

from __future__ import annotations

from typing import Final

BACKGROUND: Final = "#fbfbf8"
FILL: Final = "#ffffff"
INK: Final = "#1c2733"
BORDER: Final = "#3f5168"
EDGE: Final = "#6b7c93"
LABEL: Final = "#2f4056"
ACCENT: Final = "#1d5fa8"
"""The headings of sections."""
CODE: Final = "#33424f"

TITLE_SIZE: Final = 14.0
LABEL_SIZE: Final = 12.0
HEADING_SIZE: Final = 11.0
CODE_SIZE: Final = 11.0
BOLD: Final = 1.08
"""How much wider bold text is than the same text in the regular face."""

LINE: Final = 1.5
CORNER: Final = 8.0
LABEL_CORNER: Final = 4.0
RIM: Final = 3.5
"""Between the two borders of an accepting state."""
DASH: Final = (6.0, 4.0)
DOT: Final = 6.0
"""The radius of the dot from which the initial state is entered."""
MARGIN: Final = 16.0
