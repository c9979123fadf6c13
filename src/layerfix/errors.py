"""The one family of errors layerfix raises on purpose.

Every message is one line that names the file, the value and what would be accepted. The library raises;
only the command line turns an error into text and an exit code.
"""

from __future__ import annotations


class LayerfixError(Exception):
    """Something about the input, the options or the output that its user can put right."""


class InputError(LayerfixError):
    """A file or a value that cannot be used: missing, broken, of another kind, out of range."""


class LayerfixWarning(UserWarning):
    """Something that did not stop the work and that its user should know of."""


class OutputError(LayerfixError):
    """A target that cannot be written: it exists, the folder is read-only, the disk is full."""
