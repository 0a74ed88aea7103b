"""Pictures of several cameras on one sheet, each with a line of words."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

_WIDTH, _HEIGHT, _WORDS = 480, 360, 44  # pixels of a field, and of the words below it
_GREY, _WHITE = 40, (255, 255, 255)


def contact_sheet(pictures: Sequence[tuple[str, np.ndarray | None]]) -> np.ndarray:
    """(rows · 404, columns · 480, 3) uint8 RGB: a field for each picture (height, width, 3), grey where there is none.

    Args:
        pictures: words, of which a newline begins a second line, and picture of each field.
    """
    columns = math.ceil(math.sqrt(len(pictures)))
    rows = math.ceil(len(pictures) / columns)
    sheet = np.full((rows * (_HEIGHT + _WORDS), columns * _WIDTH, 3), _GREY, np.uint8)
    for place, (words, picture) in enumerate(pictures):
        top, left = (place // columns) * (_HEIGHT + _WORDS), (place % columns) * _WIDTH
        if picture is not None:
            scale = min(_WIDTH / picture.shape[1], _HEIGHT / picture.shape[0])
            small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[:_HEIGHT, :_WIDTH]
            y, x = top + (_HEIGHT - small.shape[0]) // 2, left + (_WIDTH - small.shape[1]) // 2
            sheet[y : y + small.shape[0], x : x + small.shape[1]] = small
        for line, text in enumerate(words.split("\n")[:2]):
            where = (left + 6, top + _HEIGHT + 17 + 20 * line)
            cv2.putText(sheet, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.48, _WHITE, 1, cv2.LINE_AA)
    return sheet
