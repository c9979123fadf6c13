"""The extension: two menu entries, a dialog, a job in the background, and one operation that can be undone.

Only what needs Cura is here: selected models become files, what comes back becomes meshes. See `command`, `frames`.
"""

import os
import tempfile

from UM.Application import Application
from UM.Extension import Extension
from UM.Job import Job
from UM.Logger import Logger
from UM.Mesh.MeshData import MeshData, calculateNormalsFromVertices
from UM.Message import Message
from UM.Operations.GroupedOperation import GroupedOperation
from UM.Operations.Operation import Operation
from UM.PluginRegistry import PluginRegistry
from UM.Scene.Selection import Selection

from . import command, frames

try:
    from PyQt6.QtCore import QObject, pyqtProperty, pyqtSignal, pyqtSlot
except ImportError:  # Cura 4
    from PyQt5.QtCore import QObject, pyqtProperty, pyqtSignal, pyqtSlot

TITLE = "Thin features"
PIXELS = 16  # to the minimum feature
FINEST_MM = 0.02
BEADS = 2  # line widths that every wall generator prints for certain
SPEEDS = {
    "external_perimeter_mm_s": "speed_wall_0",
    "perimeter_mm_s": "speed_wall_x",
    "infill_mm_s": "speed_infill",
    "solid_infill_mm_s": "speed_topbottom",
    "first_layer_mm_s": "speed_print_layer_0",
    "travel_mm_s": "speed_travel",
}


class SwapMesh(Operation):
    """Another mesh in a node's place; undone, the old one is back, the same object."""

    def __init__(self, node, mesh):
        super().__init__()
        self._node, self._new, self._old = node, mesh, node.getMeshData()

    def undo(self):
        self._node.setMeshData(self._old)

    def redo(self):
        self._node.setMeshData(self._new)


class Task:
    """One model: its triangles where it stands, as the print has them, and what to do with them."""

    def __init__(self, node, settings):
        world = node.getWorldTransformation(copy=True)
        # getMeshDataTransformed() loses the indices of meshes that share vertices.
        mesh = node.getMeshData().getTransformed(world)
        self.node, self.name, self.settings = node, node.getName(), settings
        self.world = world.getData().copy()
        self.triangles = frames.corners(frames.to_print(mesh.getVertices()), mesh.getIndices())


class CommandJob(Job):
    """Runs the command on one model after the other, in a thread of Cura's. Touches no scene."""

    def __init__(self, program, tasks, one):
        super().__init__()
        self._program, self._tasks, self._one = program, tasks, one
        self.cancelled = False
        self.message = Message(
            "Looking at {}…".format(tasks[0].name), lifetime=0, dismissable=False, progress=-1, title=TITLE
        )
        self.message.addAction("cancel", "Cancel", "", "")
        self.message.actionTriggered.connect(self._pressed)

    def _pressed(self, message, action):
        self.cancelled = True

    def run(self):
        command.check_version(self._program)
        found = []
        for number, task in enumerate(self._tasks):
            self.message.setText("{} ({} of {})".format(task.name, number + 1, len(self._tasks)))
            with tempfile.TemporaryDirectory(prefix="layerfix") as folder:
                source = os.path.join(folder, "model.stl")
                frames.write_stl(source, task.triangles)
                printer = os.path.join(folder, "cura.toml")
                with open(printer, "w", encoding="utf-8") as file:
                    file.write(command.printer_file(task.settings))
                found.append((task, self._one(self._program, task, source, printer, self._told, self._stopped)))
        self.setResult(found)

    def _stopped(self):
        return self.cancelled

    def _told(self, share):
        """Cura hides a message whose progress stands still for half a minute: so it is told again and again."""
        self.message.setProgress(-1 if share is None else share)


def corrected(program, task, source, printer, progress, cancelled):
    """(summary, corrected triangles or None if nothing was too thin)."""
    target = os.path.join(os.path.dirname(source), "fixed.stl")
    settings = task.settings
    arguments = command.fix_arguments(
        program, source, target, printer, settings["feature"], settings["first_feature"], settings["axes"]
    )
    summary = command.run(arguments, progress, cancelled)
    return summary, frames.read_stl(target) if command.is_changed(summary) else None


def suggested(program, task, source, printer, progress, cancelled):
    """(summary, None)."""
    return command.run([program, "widths", source, "-p", printer, "--json"], progress, cancelled), None


class LayerfixExtension(QObject, Extension):
    """Extensions > Thin features."""

    changed = pyqtSignal()

    def __init__(self, parent=None):
        QObject.__init__(self, parent)
        Extension.__init__(self)
        self._app = Application.getInstance()
        self._dialog = self._job = self._result = None
        for name, value in (("command", ""), ("min_feature_mm", ""), ("first_min_feature_mm", ""), ("axes", False)):
            self._app.getPreferences().addPreference("layerfix/" + name, value)
        self.setMenuName(TITLE)
        self.addMenuItem("Correct thin features…", self.ask)
        self.addMenuItem("Suggest line widths…", self.suggest)

    # What the dialog shows, and what it says when it is accepted.

    def _preference(self, name):
        return self._app.getPreferences().getValue("layerfix/" + name)

    @pyqtProperty(str, notify=changed)
    def featureText(self):
        return str(self._preference("min_feature_mm") or "")

    @pyqtProperty(str, notify=changed)
    def firstFeatureText(self):
        return str(self._preference("first_min_feature_mm") or "")

    @pyqtProperty(bool, notify=changed)
    def allAxes(self):
        return self._preference("axes") in (True, "True", "true")

    @pyqtProperty(str, notify=changed)
    def command(self):
        return str(self._preference("command") or "")

    @pyqtProperty(str, notify=changed)
    def suggestedText(self):
        return "{:g} ({} lines)".format(round(self._suggestion()[0], 3), BEADS)

    @pyqtProperty(str, notify=changed)
    def suggestedFirstText(self):
        return "{:g}".format(round(self._suggestion()[1], 3))

    def _suggestion(self):
        try:
            found = self._settings(None)
        except ValueError:
            return 0.8, 0.8
        return BEADS * found["line"], BEADS * found["first_line"]

    @pyqtSlot(str, str, bool, str)
    def accepted(self, feature, first_feature, axes, program):
        """The dialog's button: what was given is remembered, and the work begins."""
        given = (("min_feature_mm", feature.strip()), ("first_min_feature_mm", first_feature.strip()))
        for name, value in (*given, ("axes", axes), ("command", program.strip())):
            self._app.getPreferences().setValue("layerfix/" + name, value)
        self.correct()

    def ask(self):
        """Show the dialog; where it cannot be made, begin with what was chosen last."""
        if not self._nodes():
            self._say("Select the models to correct first.")
            return
        if self._dialog is None:
            path = os.path.join(PluginRegistry.getInstance().getPluginPath(self.getPluginId()), "dialog.qml")
            self._dialog = self._app.createQmlComponent(path, {"manager": self})
        if self._dialog is None:
            Logger.log("w", "the dialog of layerfix could not be made")
            self.correct()
            return
        self.changed.emit()
        self._dialog.show()

    def correct(self):
        """Thicken what is too thin in the selected models."""
        self._begin(corrected, self._put_in)

    def suggest(self):
        """Tell the line widths that lose nothing of the selected models."""
        self._begin(suggested, self._tell_widths)

    # From the scene to a job, and back.

    def _nodes(self):
        """Selected models that are printed; of groups, what is in them."""
        found, todo = [], list(Selection.getAllSelectedObjects())
        while todo:
            node = todo.pop(0)
            if node.callDecoration("isGroup"):
                todo = list(node.getChildren()) + todo
            elif node.getMeshData() and node.callDecoration("isSliceable") and node not in found:
                if not node.callDecoration("isNonPrintingMesh"):
                    found.append(node)
        return found

    def _settings(self, node):
        """What layerfix needs of the printer and its settings. Raises ValueError if there is no printer."""
        stack = self._app.getGlobalContainerStack()
        if stack is None or not stack.extruderList:
            raise ValueError("Cura has no printer yet: add one, so that nozzle and layers are known.")
        position = node.callDecoration("getActiveExtruderPosition") if node is not None else None
        extruder = stack.extruderList[int(position or 0)]

        def value(key, of=extruder):
            return float(of.getProperty(key, "value"))

        line = value("wall_line_width_0")
        definition = stack.definition
        return {
            "maker": str(definition.getMetaDataEntry("manufacturer", "") or ""),
            "model": definition.getName(),
            "width": value("machine_width", stack),
            "depth": value("machine_depth", stack),
            "height": value("machine_height", stack),
            "layer": value("layer_height", stack),
            "first_layer": value("layer_height_0", stack),
            "nozzle": value("machine_nozzle_size"),
            "filament": value("material_diameter", extruder) or 2.85,
            "line": line,
            "first_line": line * value("initial_layer_line_width_factor") / 100,
            "speeds": {name: value(key) for name, key in SPEEDS.items()},
        }

    def _asked(self, node):
        """The settings with what the user chose. Raises ValueError for a feature that is no number above 0."""
        found = self._settings(node)
        chosen = []
        for name, usual in (("min_feature_mm", found["line"]), ("first_min_feature_mm", found["first_line"])):
            text = str(self._preference(name) or "").replace(",", ".")
            try:
                feature = float(text) if text else BEADS * usual
            except ValueError:
                feature = -1.0
            if not 0 < feature < 100:
                raise ValueError("The minimum feature is '{}'; it is a number of mm, such as 0.8.".format(text))
            chosen.append(feature)
        feature, first = chosen
        # Chosen for all layers, it holds for the first, too, unless that was chosen as well.
        if self._preference("min_feature_mm") and not self._preference("first_min_feature_mm"):
            first = feature
        pixel = max(min(feature, first) / PIXELS, FINEST_MM)
        found.update(feature=feature, first_feature=first, axes=self.allAxes, pixel=pixel)
        return found

    def _begin(self, one, then):
        if self._job is not None:
            self._say("It is at work already.")
            return
        nodes = self._nodes()
        if not nodes:
            self._say("Select the models first.")
            return
        try:
            program = command.find(self._preference("command"))
            tasks = [Task(node, self._asked(node)) for node in nodes]
        except (command.Missing, ValueError) as problem:
            self._say(str(problem))
            return
        self._job = CommandJob(program, tasks, one)
        self._then = then
        self._job.message.show()
        self._job.finished.connect(self._done)
        self._job.start()

    def _done(self, job):
        self._job = None
        job.message.hide()
        if job.hasError():
            problem = job.getError()
            if isinstance(problem, command.Cancelled):
                self._say("Cancelled: nothing was changed.", 10)
            else:
                Logger.log("e", "layerfix: %s", problem)
                self._say(str(problem))
            return
        self._then(job.getResult())

    def _put_in(self, found):
        """All corrected models as one operation; those that were moved meanwhile stay as they are."""
        operation, said = GroupedOperation(), []
        for task, (summary, triangles) in found:
            node = task.node
            if node.getParent() is None or (node.getWorldTransformation(copy=True).getData() != task.world).any():
                said.append("{}: was moved or removed meanwhile, and stays as it is.".format(task.name))
                continue
            said.append(command.told_of_fix(task.name, summary))
            if triangles is None:
                continue
            local, old = frames.local_points(triangles, task.world), node.getMeshData()
            mesh = MeshData(
                vertices=local,
                normals=calculateNormalsFromVertices(local, len(local)),
                indices=frames.numpy.arange(len(local), dtype=frames.numpy.int32).reshape(-1, 3),
                file_name=old.getFileName(),
                center_position=old.getCenterPosition(),
                zero_position=old.getZeroPosition(),
            )
            operation.addOperation(SwapMesh(node, mesh))
        if operation.getNumChildrenOperations():
            operation.push()
        self._say("\n".join(said), 60)

    def _tell_widths(self, found):
        self._say("\n".join(command.told_of_widths(task.name, summary) for task, (summary, _) in found))

    def _say(self, text, seconds=0):
        Message(text, lifetime=seconds, title=TITLE).show()
