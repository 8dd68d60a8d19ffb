"""The studio: a page in the browser on which a person sees what the tracker sees and believes."""

__all__: list[str] = []
