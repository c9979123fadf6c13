"""Thin features in Cura: what Cura loads. Nothing of the host is imported before it asks."""


def getMetaData():
    """Menus and dialogs are made by the extension itself."""
    return {}


def register(app):
    """What this plugin is: one extension."""
    from .extension import LayerfixExtension

    return {"extension": LayerfixExtension()}
