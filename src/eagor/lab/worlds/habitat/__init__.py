"""Scenes of Habitat-Sim as worlds: ``--world habitat:SCENE``.

- `world`: the world itself, what follows its name, its navigation mesh and the true floor below it;
- `simulator`: simulators, whether one can be made here, and panoramas with Euclidean ranges and instance ids;
- `navmesh`: the storey that a body walks on, its ground, steps, and distances to goals;
- `semantics`: the named things of the scene, which of them a pixel shows, and the repair of their boxes;
- `export`: scenes of ours as a dataset folder for Habitat, with ObjectNav episodes.

Habitat-Sim (0.3.3 and later) is imported only when a scene is opened.
"""

from __future__ import annotations

__all__: list[str] = []
