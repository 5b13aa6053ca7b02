"""Extension of Griffe, which reads the docstrings: cached properties are attributes."""

from __future__ import annotations

import griffe

DECORATOR = "fastatt._cached.cached_property"


class CachedProperties(griffe.Extension):
    def on_function(self, *, func, **_):
        if any(d.callable_path == DECORATOR for d in func.decorators):
            attribute = griffe.Attribute(
                func.name, annotation=func.returns, docstring=func.docstring, lineno=func.lineno
            )
            attribute.labels |= {"cached", "property"}
            func.parent.set_member(func.name, attribute)
