"""Scenes of Habitat-Sim (0.3.3 and later) as worlds: ``--world habitat:SCENE``; it is imported when one is opened."""

__all__: list[str] = []  # the names are those of the modules
