"""One layer corrected: the packed kernels against NumPy + OpenCV, and against cv2's thinning alone."""

import cv2
import numpy as np

import layerfix as lf
from layerfix.layers.correction import correct_rows
from layerfix.layers.feature import feature_of_radius
from tests.benchmarks import numpy_opencv
from tests.benchmarks.layers import blobs, sparse
from tests.benchmarks.measuring import best_of, table

SIZE = 1417, 1479  # the playground of the paper's Table 1
RADIUS_PX = 10.0


def run() -> None:
    rows = []
    for name, image in (
        ("dense blobs", blobs(*SIZE, 40)),
        ("fine blobs", blobs(*SIZE, 20)),
        ("sparse", sparse(*SIZE)),
    ):
        packed = lf.pack(image)
        radii = (RADIUS_PX, RADIUS_PX)
        feature = feature_of_radius(radii)
        ours = lf.unpack(correct_rows(packed, SIZE[0], feature, "as_printed", "paper"), SIZE[0])
        assert np.array_equal(ours, numpy_opencv.correct(image, *radii))
        assert np.array_equal(ours, numpy_opencv.correct_by_lookup(image, *radii))
        grey = image.astype(np.uint8) * 255
        fast = best_of(20, lambda p=packed, f=feature: correct_rows(p, SIZE[0], f, "as_printed", "paper"))
        plain = best_of(2, lambda image=image: numpy_opencv.correct(image, RADIUS_PX, RADIUS_PX))
        tuned = best_of(3, lambda image=image: numpy_opencv.correct_by_lookup(image, RADIUS_PX, RADIUS_PX))
        thinning = best_of(
            2, lambda grey=grey: cv2.ximgproc.thinning(grey, thinningType=cv2.ximgproc.THINNING_GUOHALL)
        )
        rows.append([name, 1e3 * fast, 1e3 * plain, f"{plain / fast:.0f} ×", 1e3 * tuned, f"{tuned / fast:.0f} ×",
                     1e3 * thinning, f"{thinning / fast:.0f} ×"])  # fmt: skip
    print(f"One layer of {SIZE[0]} × {SIZE[1]} px, radius {RADIUS_PX:g} px, as_printed, one thread, ms; same bits.\n")
    table(("layer", "layerfix", "NumPy + OpenCV", "ratio", "OpenCV with lookup table", "ratio",
           "cv2.ximgproc.thinning alone", "ratio"), rows)  # fmt: skip
