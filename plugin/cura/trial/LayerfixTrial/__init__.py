"""The trial's own plugin: see run.py beside it."""


def getMetaData():
    return {}


def register(app):
    from .driver import Driver

    return {"extension": Driver()}
