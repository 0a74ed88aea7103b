"""Images as openpi's policies were trained on them: resized without distortion, padded with black."""

import numpy as np
from PIL import Image


def resize_with_pad(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """The largest copy of the image that fits, in the middle of a black one of this size.

    Bilinear, whole pixels rounded down: to the pixel what `openpi_client.image_tools.resize_with_pad` (0.1.2) makes,
    which openpi uses in training too.

    Args:
        image: (H, W, 3), uint8.

    Returns:
        (height, width, 3), uint8.
    """
    if image.shape[:2] == (height, width):
        return image
    shrink = max(image.shape[1] / width, image.shape[0] / height)
    inner_height, inner_width = int(image.shape[0] / shrink), int(image.shape[1] / shrink)
    inner = Image.fromarray(image).resize((inner_width, inner_height), resample=Image.Resampling.BILINEAR)
    top, left = (height - inner_height) // 2, (width - inner_width) // 2
    padded = np.zeros((height, width, 3), dtype=np.uint8)
    padded[top : top + inner_height, left : left + inner_width] = np.asarray(inner)
    return padded
