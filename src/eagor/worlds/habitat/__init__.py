"""Scenes of Habitat-Sim as worlds: ``--world habitat:SCENE``.

- `world`: the world itself, and the scene that it gives to tasks; `options`: what follows its name;
- `simulator`: what a simulator is made of, whether one can be made here, those that are open;
- `view`: coordinates, and panoramas with Euclidean ranges and instance ids;
- `surface`: the storey that a body walks on, and its steps; `navmesh`: its ground, and distances to goals; `floors`:
  meshes, and the true floors below them;
- `semantics`: the named things of the scene, which of them a pixel shows, and the repair of their boxes.

Habitat-Sim (0.3.3 and later) is imported only when a scene is opened.
"""

from __future__ import annotations

__all__: list[str] = []
