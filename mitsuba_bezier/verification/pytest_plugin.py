"""What pytest loads in any project where this package is installed: the name of the plugin.

The plugin itself is `mitsuba_bezier.regression.plugin`. It stands above the command line, whose way
of rendering it uses; this module has the name that entry point and ``-p`` have always had.
"""

from __future__ import annotations

pytest_plugins = ("mitsuba_bezier.regression.plugin",)
