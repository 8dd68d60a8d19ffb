"""Shared by local and served vision-language models: families, prompts, answers, projection back to the sphere.

It uses NumPy, Pillow and the core only, neither torch nor a server.
"""

__all__: list[str] = []  # the names are those of the modules
