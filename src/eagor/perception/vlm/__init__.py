"""What local and served vision-language models share: prompts, reading of answers, sizes, the seam, tangent views.

NumPy, Pillow and the core only; nothing here needs torch or a server.
"""

__all__: list[str] = []  # the names are those of the modules
