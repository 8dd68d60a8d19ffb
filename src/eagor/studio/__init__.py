"""The studio: a page in the browser on which a person sees what the tracker sees and believes.

`eagor.studio.server` is the web server, `eagor.studio.engine` the process in which sessions run. The page itself is
TypeScript, in ``studio/`` at the root of the repository; its built files ship with the package.
"""

__all__: list[str] = []
