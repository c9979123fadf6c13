"""A stand-in for OrcaSlicer's embedded module `orca`, made from the published signatures of 2.5, for tests.

It keeps the rules that a plugin can break: coordinates are int64 in units of `unscale(1)` mm, options are strings,
arguments of another type are a TypeError, arrays of another kind a ValueError, rings are turned the right way round,
references die when their collection is replaced (there: undefined; here: StaleReferenceError), capabilities register
only while the plugin is loaded, and within a call of a capability no file is opened and no process or socket made.
"""

from __future__ import annotations

import enum
import importlib
import json
import sys
import types
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import shapely

UNIT_MM = 1e-6
FORBIDDEN = ("open", "os.", "subprocess.", "socket.", "shutil.", "tempfile.", "ctypes.dlopen")
HARMLESS = ("os.urandom",)


class StaleReferenceError(RuntimeError):
    """A reference into a collection that was replaced since."""


class RefusedError(PermissionError):
    """What the host's audit would ask the user about, or deny."""


_inside = False
_hooked = False


def _audit(event: str, args: Any) -> None:
    if _inside and event.startswith(FORBIDDEN) and event not in HARMLESS:
        raise RefusedError(f"{event} {args!r:.200} within a call of a capability")


@contextmanager
def audited() -> Iterator[None]:
    """A call of a capability, in whatever thread."""
    global _inside, _hooked
    if not _hooked:
        sys.addaudithook(_audit)
        _hooked = True
    _inside = True
    try:
        yield
    finally:
        _inside = False


class _Held:
    """Something that may belong to a collection, and dies with what the collection held."""

    _owner: SurfaceCollection | None = None
    _born = 0

    def _of(self, owner: SurfaceCollection | None, born: int) -> Any:
        self._owner, self._born = owner, born
        return self

    def _alive(self) -> None:
        if self._owner is not None and self._owner._born != self._born:
            raise StaleReferenceError(f"{type(self).__name__} of slices that were set anew")


def _points(given: Any, who: str) -> np.ndarray:
    if isinstance(given, Polygon):
        given._alive()
        return given._points.copy()
    if not isinstance(given, np.ndarray) or given.dtype != np.int64:
        raise ValueError(f"{who}: polygon coordinates must be an (N,2) int64 ndarray")
    if given.ndim != 2 or given.shape[1] != 2 or len(given) < 3:
        raise ValueError(f"{who}: each polygon array must have shape (N,2), N >= 3")
    return np.array(given)


def _doubled_area(points: np.ndarray) -> float:
    x, y = points.astype(float).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


class Polygon(_Held):
    def __init__(self) -> None:
        self._points = np.empty((0, 2), np.int64)

    def as_array(self) -> np.ndarray:
        self._alive()
        return self._points  # a view that can be written to


def _polygon(points: np.ndarray) -> Polygon:
    made = Polygon()
    made._points = points
    return made


class ExPolygon(_Held):
    def __init__(self, contour: Any, holes: Any = None) -> None:
        if holes is not None and not isinstance(holes, (list, tuple)):
            raise ValueError("ExPolygon: holes must be a list of Polygon or (N,2) ndarrays")
        outer = _points(contour, "ExPolygon.contour")
        inner = [_points(hole, "ExPolygon.hole") for hole in holes or []]
        self._contour = _polygon(outer if _doubled_area(outer) >= 0 else outer[::-1].copy())
        self._holes = [_polygon(hole if _doubled_area(hole) <= 0 else hole[::-1].copy()) for hole in inner]

    @property
    def contour(self) -> Polygon:
        self._alive()
        return self._contour._of(self._owner, self._born)

    @property
    def holes(self) -> list[Polygon]:
        self._alive()
        return [hole._of(self._owner, self._born) for hole in self._holes]

    def _copy(self) -> ExPolygon:
        self._alive()
        return ExPolygon(self._contour._points, [hole._points for hole in self._holes])

    def _shape(self) -> shapely.Polygon:
        return shapely.Polygon(self._contour._points, [hole._points for hole in self._holes])


SurfaceType = enum.IntEnum("SurfaceType", "stTop stBottom stInternal stInternalSolid stPerimeter", start=0)
PluginResult = enum.Enum("PluginResult", "Success Skipped RecoverableError FatalError", start=0)
Step = enum.Enum("Step", "posSlice posPerimeters posPrepareInfill posInfill psSkirtBrim psGCodePostProcess", start=0)


class Surface(_Held):
    def __init__(self, surface_type: Any, expolygon: Any) -> None:
        if not isinstance(surface_type, SurfaceType) or not isinstance(expolygon, ExPolygon):
            raise TypeError("Surface(): incompatible constructor arguments")
        self.surface_type = surface_type
        self._expolygon = expolygon._copy()

    @property
    def expolygon(self) -> ExPolygon:
        self._alive()
        return self._expolygon._of(self._owner, self._born)


class SurfaceCollection:
    def __init__(self) -> None:
        self._surfaces: list[Surface] = []
        self._born = 0

    @property
    def surfaces(self) -> list[Surface]:
        return [surface._of(self, self._born) for surface in self._surfaces]

    def set(self, expolygons: Any, surface_type: Any = None) -> None:
        if not isinstance(expolygons, list):
            raise TypeError("set(): incompatible function arguments: a list is needed")
        if surface_type is None and not all(isinstance(one, Surface) for one in expolygons):
            raise TypeError("set(): incompatible function arguments")
        if surface_type is not None and not all(isinstance(one, ExPolygon) for one in expolygons):
            raise TypeError("set(): incompatible function arguments")
        made = [
            Surface(one.surface_type, one.expolygon) if surface_type is None else Surface(surface_type, one)
            for one in expolygons
        ]
        self._surfaces, self._born = made, self._born + 1

    def shape(self) -> shapely.Geometry:
        """For tests: the area, in units."""
        return shapely.union_all([surface._expolygon._shape() for surface in self._surfaces])


class _Options:
    def __init__(self, values: dict[str, Any]) -> None:
        self._values = {key: str(value) for key, value in values.items()}

    def config_value(self, key: str) -> str | None:
        if not isinstance(key, str):
            raise TypeError("config_value(): incompatible function arguments")
        return self._values.get(key)


class LayerRegion(_Options):
    def __init__(self) -> None:
        super().__init__({})
        self.slices = SurfaceCollection()


class Layer:
    def __init__(self, print_z: float, height: float, regions: list[list[list[np.ndarray]]]) -> None:
        self.print_z, self.slice_z, self.height = print_z, print_z - height / 2, height
        self.made = 0  # for tests: how often make_slices was called
        self._regions = [LayerRegion() for _ in regions]
        for region, polygons in zip(self._regions, regions, strict=True):
            region.slices.set([ExPolygon(rings[0], list(rings[1:])) for rings in polygons], SurfaceType.stInternal)

    def regions(self) -> list[LayerRegion]:
        return list(self._regions)

    def make_slices(self) -> None:
        self.made += 1


class PrintObject(_Options):
    def __init__(
        self, layers: list[Layer], options: dict[str, Any] | None = None, name: str = "part", number: int = 1
    ) -> None:
        super().__init__(options or {})
        self._layers, self._name, self._number = layers, name, number

    def id(self) -> int:
        return self._number

    def layers(self) -> list[Layer]:
        return list(self._layers)

    def model_object(self) -> Any:
        return types.SimpleNamespace(name=self._name)


class Print(_Options):
    def __init__(self, objects: list[PrintObject], options: dict[str, Any]) -> None:
        super().__init__(options)
        self._objects = objects
        self.cancel_after = sys.maxsize  # for tests: so many questions are answered with no

    def objects(self) -> list[PrintObject]:
        return list(self._objects)

    def canceled(self) -> bool:
        self.cancel_after -= 1
        return self.cancel_after < 0


class Context:
    def __init__(self, step: Any, print_: Print | None, thing: PrintObject | None) -> None:
        self.step, self.print, self.object, self.orca_version = step, print_, thing, "2.5.0"

    def config_value(self, key: str) -> str | None:
        return self.print.config_value(key) if self.print is not None else None

    def cancelled(self) -> bool:
        return self.print is not None and self.print.canceled()


class ExecutionResult:
    def __init__(self, status: Any, message: str = "") -> None:
        if not isinstance(status, PluginResult) or not isinstance(message, str):
            raise TypeError("ExecutionResult(): incompatible constructor arguments")
        self.status, self.message = status, message

    @staticmethod
    def success(message: str = "") -> ExecutionResult:
        return ExecutionResult(PluginResult.Success, message)

    @staticmethod
    def skipped(message: str = "") -> ExecutionResult:
        return ExecutionResult(PluginResult.Skipped, message)

    @staticmethod
    def failure(status: Any, message: str) -> ExecutionResult:
        return ExecutionResult(status, message)


class PythonPluginBase:
    _saved = "{}"

    def get_name(self) -> str:
        raise RuntimeError('Tried to call pure virtual function "get_name"')

    def get_default_config(self) -> dict[str, Any]:
        return {}

    def get_config(self) -> str:
        return self._saved

    def save_config(self, config: str) -> bool:
        json.loads(config)
        self._saved = config
        return True

    def on_load(self) -> None:
        pass


class SlicingPipelineCapabilityBase(PythonPluginBase):
    def execute(self, ctx: Context) -> ExecutionResult:
        raise RuntimeError('Tried to call pure virtual function "execute"')


class PagesPluginCapabilityBase(PythonPluginBase):
    def __init__(self) -> None:
        self.posted: list[Any] = []

    def get_ui(self) -> str:
        raise RuntimeError('Tried to call pure virtual function "get_ui"')

    def post_message(self, message: Any) -> None:
        self.posted.append(json.loads(json.dumps(message)))


class Base:
    def register_capabilities(self) -> None:
        raise RuntimeError("pure virtual")


class Host:
    """The program: its module, and how it installs and loads a wheel."""

    def __init__(self) -> None:
        self.loading = False
        self.packages: list[type] = []
        self.registered: list[type] = []
        self.module = types.ModuleType("orca")
        self.module.__dict__.update(
            plugin=self._plugin,
            register_capability=self._register,
            base=Base,
            PythonPluginBase=PythonPluginBase,
            PluginResult=PluginResult,
            ExecutionResult=ExecutionResult,
            host=types.SimpleNamespace(
                Polygon=Polygon, ExPolygon=ExPolygon, Surface=Surface, SurfaceType=SurfaceType
            ),
            slicing=types.SimpleNamespace(
                Step=Step,
                unscale=lambda value: value * UNIT_MM,
                SlicingPipelineCapabilityBase=SlicingPipelineCapabilityBase,
            ),
            pages=types.SimpleNamespace(PagesPluginCapabilityBase=PagesPluginCapabilityBase),
        )

    def _plugin(self, package: type) -> type:
        if not self.loading:
            raise ValueError("@orca.plugin used outside plugin discovery context")
        if not issubclass(package, Base) or self.packages:
            raise ValueError("exactly one subclass of orca.base is decorated with @orca.plugin")
        self.packages.append(package)
        return package

    def _register(self, capability: type) -> None:
        if not self.loading:
            raise ValueError("register_capability() called outside plugin discovery context")
        if not issubclass(capability, PythonPluginBase):
            raise ValueError("Registered class must inherit from a PluginCapability base")
        self.registered.append(capability)

    def load(self, package: str) -> list[PythonPluginBase]:
        """Import a plugin's package, which is on the path, and make its capabilities."""
        sys.modules["orca"] = self.module
        self.loading = True
        try:
            importlib.import_module(package)
            if not self.packages:
                raise ValueError("Plugin did not register a package class")
            self.packages[0]().register_capabilities()
        finally:
            self.loading = False
        made = [capability() for capability in self.registered]
        names = [one.get_name() for one in made]
        if not made or len(set(names)) < len(names) or any(";" in name for name in names):
            raise ValueError(f"capabilities are named {names}: at least one, each of its own, without ';'")
        for one in made:
            one.on_load()
        return made

    def install(self, archive: Path, data_dir: Path) -> tuple[str, dict[str, str]]:
        """As the Plugins dialog does: (the entry package, its metadata); its files are on the path then."""
        folder = data_dir / "orca_plugins" / archive.name
        folder.mkdir(parents=True)
        entry = folder / archive.name
        entry.write_bytes(archive.read_bytes())
        with zipfile.ZipFile(entry) as wheel:
            info = {name.partition("/")[0] for name in wheel.namelist() if ".dist-info/" in name}
            if len(info) != 1:
                raise ValueError(f"{len(info)} .dist-info folders; exactly one is needed")
            (where,) = info
            metadata, record = (wheel.read(f"{where}/{name}").decode() for name in ("METADATA", "RECORD"))
            if not record or "Tag: py3-none-any" not in wheel.read(f"{where}/WHEEL").decode():
                raise ValueError("RECORD is empty, or the wheel is for some machines only")
            package = wheel.read(f"{where}/top_level.txt").decode().strip()
            if not package or "\n" in package:
                raise ValueError("top_level.txt has not exactly one line")
            extracted = folder / "__whl_extracted__" / package
            wheel.extractall(extracted)
        head = metadata.partition("\n\n")[0].splitlines()
        fields = dict(line.split(": ", 1) for line in reversed(head))
        if not {"Name", "Version"} <= set(fields):
            raise ValueError("METADATA has no Name or no Version")
        sys.path.insert(0, str(extracted))
        return package, {**fields, "plugin_key": archive.stem, "folder": str(extracted)}
