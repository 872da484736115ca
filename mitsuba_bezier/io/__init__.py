"""File formats, one module each; `load` and `save` choose by suffix."""
