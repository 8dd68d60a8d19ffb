"""How much of a view's evidence leaks into directions that nobody looked at, and what each remedy costs.

    python benchmarks/leak.py [--degree 15]

Three ways to project the evidence of one view: plainly; with a taper inside the border, as wide as ours and twice as
wide; and ours, a taper and the confinement of `eagor.evidence.coverage`. For a uniform field of one nat and for a blob
near the border, the table gives the largest value beyond 30 degrees outside the border, and what is left of the
blob's height.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

import eagor
from eagor.evidence import coverage
from eagor.sphere import angular_distance

VIEWS = {
    "100 degrees, 16:9": eagor.PerspectiveGrid(36, 64, math.radians(100)),
    "60 degrees, square": eagor.PerspectiveGrid(40, 40, math.radians(60)),
    "140 degrees, 3:2": eagor.PerspectiveGrid(40, 60, math.radians(140)),
    "fisheye, 150 degrees": eagor.FisheyeGrid(40, math.radians(150)),
}


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--degree", type=int, default=15)
    degree = arguments.parse_args().degree
    basis, sphere = eagor.RealHarmonics(degree), eagor.ErpGrid(64, 128)
    margin = math.pi / (degree + 1)
    print(f"degree {degree}; leak of one nat, uniform / blob at the border; height kept of that blob\n")
    print(f"{'view':22s} {'plain':>22s} {'taper':>22s} {'taper, twice as wide':>22s} {'ours':>22s}")
    for name, view in VIEWS.items():
        depth, where = view.depth_inside(), coverage.region(view, None)
        assert depth is not None
        assert where is not None
        row, column = view.shape[0] // 2, int(view.shape[1] * 0.8)
        spot = view.directions[row, column]
        blob = np.exp(-0.5 * (angular_distance(view.directions, spot) / math.radians(8)) ** 2)
        apart = coverage._distance(sphere.directions, coverage._rim(where))
        outside = ~coverage._contains(where, sphere.directions) & (apart > math.radians(30))
        height = float(basis.synthesise(basis.analyse(blob, view), spot))
        cells = []
        for width, confined in [(0.0, False), (margin, False), (2 * margin, False), (margin, True)]:
            taper = np.sin(np.clip(depth / width, 0, 1) * math.pi / 2) ** 2 if width else np.ones(view.shape)
            found = [basis.analyse(taper * values, view) for values in (np.ones(view.shape), blob)]
            if confined:
                found = [coverage.confine(degree, c, where) for c in found]
            leaks = [float(np.abs(basis.synthesise(c, sphere)[outside]).max()) for c in found]
            kept = float(basis.synthesise(found[1], spot)) / height
            cells.append(f"{leaks[0]:.4f} / {leaks[1]:.4f}  {100 * kept:3.0f} %")
        print(f"{name:22s} " + " ".join(f"{cell:>22s}" for cell in cells))


if __name__ == "__main__":
    main()
