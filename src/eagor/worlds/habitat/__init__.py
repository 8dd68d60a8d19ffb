"""Scenes of Habitat-Sim as worlds: ``--world habitat:SCENE``.

- `world`: the world itself, and the scene that it gives to tasks; `options`: what follows its name;
- `probe`: finds out, in another process, whether a simulator can be made here, and on which device;
- `configuring`: what a simulator is made of; `sessions`: those that are open in this process;
- `frames`: the one place in which coordinates change;
- `view`: panoramas with Euclidean ranges and instance ids;
- `navmesh`: where a body can walk; `surface`: its points and paths; `ways`: distances to several goals; `steps`: its
  steps; `raster`: its plan; `storeys`: the storey that it walks on; `floors`: meshes, and the true floors below them;
- `semantics`: the named things of the scene; `labels`: which of them a pixel shows; `extents`: repairs their boxes.

Habitat-Sim (0.3.3 and later) is imported only when a scene is opened.
"""

from __future__ import annotations

__all__: list[str] = []
