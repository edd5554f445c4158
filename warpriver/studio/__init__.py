"""The studio: shape living rivers in the browser. It uses what every program can use, and nothing else.

:func:`make_app` is the application, ``warpriver studio`` serves it on this machine.
"""

from warpriver.studio.app import make_app

__all__ = ["make_app"]
