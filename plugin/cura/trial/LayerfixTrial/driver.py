"""Presses what a person would press in a running Cura, step by step, and writes what came of it as JSON lines.

A step is a generator: what it yields is what it waits for (seconds, or a condition that is asked until it holds).
"""

import json
import os
import subprocess
import time

from PyQt5.QtCore import QTimer, QUrl
from UM.Application import Application
from UM.Extension import Extension
from UM.Math.Quaternion import Quaternion
from UM.Math.Vector import Vector
from UM.Operations.RotateOperation import RotateOperation
from UM.Scene.Iterator.DepthFirstIterator import DepthFirstIterator
from UM.Scene.Selection import Selection

FOLDER = os.environ.get("LAYERFIX_TRIAL", "")
PATIENCE_S = 240


class Driver(Extension):
    def __init__(self):
        super().__init__()
        if FOLDER:
            self.app = Application.getInstance()
            self.app.engineCreatedSignal.connect(self._begin)

    def _begin(self):
        self._steps = self._all()
        QTimer.singleShot(2000, self._next)

    def _next(self, waited=0.0, until=None):
        try:
            if until is not None and not until():
                if waited > PATIENCE_S:
                    raise RuntimeError("waited in vain")
                QTimer.singleShot(200, lambda: self._next(waited + 0.2, until))
                return
            wanted = next(self._steps)
        except StopIteration:
            self._end()
        except Exception:
            import traceback

            self._note("broken", False, traceback.format_exc())
            self._end()
        else:
            if callable(wanted):
                self._next(0.0, wanted)
            else:
                QTimer.singleShot(int(1000 * wanted), self._next)

    def _end(self):
        with open(os.path.join(FOLDER, "end"), "w") as file:
            file.write("end")
        self.app.closeApplication()

    def _note(self, what, held, more=""):
        with open(os.path.join(FOLDER, "facts.jsonl"), "a") as file:
            file.write(json.dumps({"fact": what, "held": bool(held), "more": str(more)}) + "\n")

    # What a person does and sees.

    @property
    def ours(self):
        from UM.PluginRegistry import PluginRegistry

        return PluginRegistry.getInstance().getPluginObject("Layerfix")

    def _nodes(self):
        scene = self.app.getController().getScene().getRoot()
        return [node for node in DepthFirstIterator(scene) if node.callDecoration("isSliceable")]

    def _texts(self):
        return "\n".join(message.getText() for message in self.app.getVisibleMessages())

    def _clear(self):
        for message in list(self.app.getVisibleMessages()):
            message.hide()

    def _picture(self, name):
        subprocess.call(["import", "-window", "root", os.path.join(FOLDER, name + ".png")])

    def _load(self, name):
        self.app.readLocalFile(QUrl.fromLocalFile(os.path.join(FOLDER, name)))

    def _idle(self):
        return self.ours._job is None

    def _prefer(self, name, value):
        self.app.getPreferences().setValue("layerfix/" + name, value)

    def _press(self, entry):
        self.ours.activateMenuItem(entry)

    def _slice(self):
        """Slices; afterwards self.sliced is the G-code."""
        self.sliced = None
        backend = self.app.getBackend()
        if not getattr(self, "_listening", False):
            self._listening = True
            backend.backendStateChange.connect(self._state)
        backend.forceSlice()

    def _state(self, state):
        if int(state) == 3:  # done
            chunks = getattr(self.app.getController().getScene(), "gcode_dict", {}).get(0, [])
            self.sliced = "".join(chunks)

    def _all(self):
        stack = self.app.getOperationStack()
        self._clear()
        self._note("the extension is loaded", self.ours is not None)
        self._note("it has its two entries", list(self.ours.getMenuItemList()) ==
                   ["Correct thin features…", "Suggest line widths…"], self.ours.getMenuItemList())  # fmt: skip

        self._press("Correct thin features…")
        yield 0.5
        self._note("nothing selected: it says so", "Select the models" in self._texts(), self._texts())
        self._clear()

        self._load("fin.stl")
        yield self._nodes
        yield 2
        self._clear()
        node = self._nodes()[0]
        Selection.add(node)
        RotateOperation(node, Quaternion.fromAngleAxis(0.5, Vector.Unit_Y)).push()
        yield 2
        mesh, world = node.getMeshData(), node.getWorldTransformation(copy=True).getData().copy()
        operations = len(stack.getOperations())

        self._prefer("command", "/no/such/program")
        self._press("Suggest line widths…")
        yield 0.5
        self._note("a missing program: it says what to do", "pip install layerfix" in self._texts(), self._texts())
        self._clear()
        self._prefer("command", os.path.join(FOLDER, "of_another_version"))
        self._press("Suggest line widths…")
        yield self._idle
        yield 0.5
        self._note("another version: it names both", "9.7" in self._texts() and "0.1" in self._texts(), self._texts())
        self._clear()
        self._prefer("command", os.path.join(FOLDER, "slow"))
        self.ours.correct()
        yield 2
        self._picture("working")
        self.ours._job.message.actionTriggered.emit(self.ours._job.message, "cancel")
        yield self._idle
        yield 0.5
        left = os.path.exists(os.path.join(FOLDER, "slow.running"))
        stopped = node.getMeshData() is mesh and "Cancelled" in self._texts() and not left
        self._note("cancelled: the program is stopped, the model as it was", stopped, self._texts())
        self._clear()
        self._prefer("command", "")
        self._prefer("min_feature_mm", "wide")
        self.ours.correct()
        yield 0.5
        self._note("a feature that is no number: it says so", "'wide'" in self._texts(), self._texts())
        self._clear()
        self._prefer("min_feature_mm", "")

        self._slice()
        yield lambda: self.sliced is not None
        with open(os.path.join(FOLDER, "before.gcode"), "w") as file:
            file.write(self.sliced)

        self._press("Correct thin features…")
        yield 2
        self._picture("dialog")
        self._note("the dialog is shown", self.ours._dialog is not None and self.ours._dialog.property("visible"))
        self._note("it proposes two line widths", self.ours.suggestedText, self.ours.suggestedText)
        began = time.time()
        self.ours._dialog.close()
        self.ours.accepted("", "", False, "")
        yield self._idle
        took = time.time() - began
        yield 2
        self._note("the mesh is another", node.getMeshData() is not mesh, f"{took:.1f} s")
        self._note("its summary is told", "layers corrected" in self._texts(), self._texts())
        self._picture("corrected")
        self._clear()
        same = abs(node.getWorldTransformation(copy=True).getData() - world).max()
        self._note("the model stands where it stood", same < 1e-4, same)
        self._note("it is one operation", stack.canUndo() and len(stack.getOperations()) == operations + 1,
                   [type(one).__name__ for one in stack.getOperations()])  # fmt: skip
        self._slice()
        yield lambda: self.sliced is not None
        with open(os.path.join(FOLDER, "after.gcode"), "w") as file:
            file.write(self.sliced)
        stack.undo()
        yield 0.5
        back = abs(node.getWorldTransformation(copy=True).getData() - world).max()
        self._note("one undo brings the mesh back, the same", node.getMeshData() is mesh and back < 1e-4, back)
        stack.redo()
        yield 0.5
        self._note("redo the corrected one", node.getMeshData() is not mesh)
        self._clear()
        again = node.getMeshData()
        self.ours.correct()
        yield self._idle
        yield 1
        self._note("corrected once more, nothing is left to do",
                   node.getMeshData() is again or "added" in self._texts(), self._texts())  # fmt: skip
        self._clear()

        stack.undo()
        self._press("Suggest line widths…")
        yield self._idle
        yield 1
        self._note("widths are told by height", "z 0.00 to" in self._texts() and "too thin" in self._texts(),
                   self._texts())  # fmt: skip
        self._picture("widths")
        self._clear()

        self.ours.correct()
        node.setPosition(node.getPosition() + Vector(5, 0, 0))
        yield self._idle
        yield 1
        self._note("moved meanwhile: it stays as it is", node.getMeshData() is mesh and "was moved" in self._texts(),
                   self._texts())  # fmt: skip
        self._clear()
        Selection.clear()
        for name in ("overlapping.stl", "open.stl"):
            before = len(self._nodes())
            self._load(name)
            yield lambda before=before: len(self._nodes()) > before
            yield 2
            self._clear()
            other = self._nodes()[-1]
            Selection.add(other)
            old = other.getMeshData()
            self.ours.correct()
            yield self._idle
            yield 1
            self._note(f"{name}: corrected, or refused in words",
                       other.getMeshData() is not old or self._texts(), self._texts())  # fmt: skip
            self._clear()
            Selection.clear()
        if os.path.exists(os.path.join(FOLDER, "timed.stl")):
            before = len(self._nodes())
            self._load("timed.stl")
            yield lambda: len(self._nodes()) > before
            yield 3
            self._clear()
            Selection.add(self._nodes()[-1])
            began = time.time()
            self.ours.correct()
            yield self._idle
            took, said = time.time() - began, self._texts()
            self._note("the model to be timed is corrected", "corrected" in said or "thinner" in said,
                       f"{took:.2f} s from menu to mesh")  # fmt: skip
            self._clear()
