"""Scenes of Habitat-Sim (0.3.3 and later) as worlds: ``--world habitat:SCENE``; it is imported when one is opened."""
