"""Build direction: 300 evaluations beside the paper's minutes, what they are spent on, methods, and workers."""

import os
import pickle
import time
from pathlib import Path

import numpy as np

import layerfix as lf
from layerfix.mesh.cutter import bucket, cut
from layerfix.mesh.fill import fill
from layerfix.mesh.pieces import small_pieces
from layerfix.orientation.candidates import facets, large_faces
from layerfix.orientation.directions import AS_GIVEN, Pose, fibonacci, pose_of
from layerfix.orientation.engines import Engine, Threads
from layerfix.orientation.executors import Processes
from layerfix.orientation.objective import FULL, Objective, Printing
from layerfix.samples import SAMPLES
from tests.benchmarks.measuring import table

# Table 2 of the paper: minutes of at most 300 evaluations on 8 cores, and the reduction they won.
PAPER = {
    "molecule": (62, 34.2),
    "threaded-cylinder": (236, 98.7),
    "dragon": (35, 51.7),
    "helical-tower": (151, 16.1),
}
PAPERS = 300  # evaluations
EVALUATIONS = int(os.environ.get("LAYERFIX_EVALUATIONS", "300"))
# Other people's parts, if they are there: a folder in $LAYERFIX_MESHES.
OTHERS = (
    "benchy_deck.stl",
    "heatwave_2.stl",
    "atom_carbon.stl",
    "rpi_zero_frame.stl",
    "screw_m3x10.stl",
    "vase_twisted.stl",
)
SEEDS = int(os.environ.get("LAYERFIX_SEEDS", "10"))


def objective_of(name: str, spurs: str = "metric") -> Objective:
    """Of a sample as in the paper's table, the cylinder lying as there; of another part at 0.1 mm and F = 0.8 mm."""
    if name in SAMPLES:
        sample = SAMPLES[name]
        mesh = sample.mesh()
        if name == "threaded-cylinder":
            mesh = mesh.transformed(Pose(np.pi / 2, 0.0).matrix)
        how = (sample.pixel_mm,) * 2, sample.layer_mm, sample.min_feature_mm
        return Objective(mesh, Printing(*how, spurs=spurs))
    mesh = lf.load_mesh(Path(os.environ["LAYERFIX_MESHES"]) / name)
    step = 0.1 if max(mesh.size_mm) > 20 else 0.03
    return Objective(mesh, Printing((step, step), step, 8 * step, spurs=spurs))


def evaluated(engine: Engine, poses: list[Pose]) -> tuple[float, float]:
    """Seconds of counting them in full, and of processors at it (of this process)."""
    started, busy = time.perf_counter(), time.process_time()
    for _ in engine.run([(pose, 0, FULL) for pose in poses]):
        pass
    return time.perf_counter() - started, time.process_time() - busy


def shares(objective: Objective, poses: list[Pose]) -> tuple[float, float, float]:
    """Of one thread's time: turning and snapping the vertices, slicing, correcting and counting."""
    turning = slicing = total = 0.0
    for pose in poses:
        started = time.thread_time()
        objective.count(pose)
        total += time.thread_time() - started
        started = time.thread_time()
        part = objective.cut(pose, objective.stand(pose))
        turning += time.thread_time() - started
        assert part is not None
        width, height = part.size_px
        started = time.thread_time()
        starts, crossed = bucket(part.points, part.faces, part.planes, 1)
        rows = np.zeros((height, (width + 63) // 64), np.uint64)
        for k, plane in enumerate(part.planes):
            segments = cut(part.points, part.faces, crossed[starts[k] : starts[k + 1]], plane)
            rows[:] = 0
            fill(segments, width, 1, True, rows)
            small_pieces(segments, rows)
        slicing += time.thread_time() - started
    return turning / total, slicing / total, 1 - (turning + slicing) / total


def speed() -> None:
    """The paper's four models."""
    rows = []
    directions = [pose_of(d) for d in fibonacci(EVALUATIONS)]
    for name, (minutes, _) in PAPER.items():
        for spurs in ("metric", "paper"):
            objective = objective_of(name, spurs)
            engine = Threads(objective)
            evaluated(engine, directions[:2])
            seconds, busy_s = evaluated(engine, directions)
            parts = shares(objective, directions[::60]) if spurs == "metric" else None
            spent = " / ".join(f"{100 * part:.0f} %" for part in parts) if parts else ""
            rate, paper_s = EVALUATIONS / seconds, 60.0 * minutes * EVALUATIONS / PAPERS
            rows.append([name, spurs, seconds, busy_s, rate, paper_s, f"{paper_s / seconds:.0f} ×",
                         f"{paper_s / (busy_s / engine.workers):.0f} ×", spent])  # fmt: skip
    print(
        f"{EVALUATIONS} directions in full, {len(os.sched_getaffinity(0))} threads; the paper: {PAPERS} on 8 cores at"
        " 3.7 GHz. Idle: the ratio if the threads had the cores to themselves.\n"
    )
    head = (
        "model",
        "ends of paths",
        "s",
        "processor s",
        "a second",
        "paper, s",
        "ratio",
        "idle",
        "turn / slice / correct",
    )
    table(head, rows)


def over_angles(objective: Objective, pose: Pose) -> float:
    """C, the mean over eight angles on the plate: which of them is best is luck of the pixels for the most part."""
    found = [objective.count(pose.turned(pose.psi + k * np.pi / 16)) for k in range(8)]
    return float(np.mean([c.added + c.removed for c in found]))


def methods() -> None:
    """Objective (at the angle on the plate that was found, and over angles), full evaluations, seconds of methods."""
    rows = []
    others = OTHERS if os.environ.get("LAYERFIX_MESHES") else ()
    for name in (*PAPER, *others):
        objective = objective_of(name)
        printing = objective.printing
        how = {
            "pixel_mm": printing.pixel_mm,
            "layer_mm": printing.layer_mm,
            "min_feature_mm": printing.min_feature_mm,
        }
        given = objective.count(AS_GIVEN)
        initial = given.added + given.removed
        normals, areas, _ = facets(objective.mesh)
        started = time.perf_counter()
        faces = [objective.count(pose_of(d)) for d in large_faces(normals, areas, 10)]
        rows.append([name, "as given", initial, 0.0, f"{over_angles(objective, AS_GIVEN):.0f}", 1, 0.0])
        best = min(c.added + c.removed for c in faces)
        rows.append(["", "10 largest faces", best, 100 * (1 - best / initial), "", len(faces),
                     time.perf_counter() - started])  # fmt: skip
        for method in ("anneal", "direct", "quick", "race"):
            seeds = range(SEEDS if method == "anneal" else 1)
            found = [lf.orient(objective.mesh, method=method, seed=seed, **how) for seed in seeds]
            changed = [one.best.changed_px for one in found]
            spread = f" ({min(changed)}–{max(changed)})" if len(found) > 1 else ""
            mean = float(np.mean(changed))
            turned = np.mean([over_angles(objective, one.best.pose) for one in found])
            rows.append(["", method, f"{mean:.0f}{spread}", 100 * (1 - mean / initial), f"{turned:.0f}",
                         float(np.mean([one.equivalents for one in found])),
                         float(np.mean([one.seconds for one in found]))])  # fmt: skip
    print(f"C in pixels; annealing: the mean (least–most) of {SEEDS} seeds.\n")
    table(("model", "method", "C", "% less", "C over 8 angles", "evaluations", "seconds"), rows)


def workers() -> None:
    """Evaluations a second with more processes, on as many cores as there are."""
    objective = objective_of("molecule")
    poses = [pose_of(d) for d in fibonacci(160)]
    rows: list[list[object]] = []
    for count in (1, 2, 4, 8):
        engine = Processes(objective, count)
        evaluated(engine, poses[: 4 * count])  # the processes begin, and read the part
        seconds, _ = evaluated(engine, poses)
        engine.close()
        rows.append([count, len(poses) / seconds, len(poses) / seconds / float(rows[0][1]) if rows else 1.0])
    task = [(poses[0], 0, FULL)]
    print(
        f"Molecule, {len(os.sched_getaffinity(0))} cores: more processes than cores cannot be faster. A task is"
        f" {len(pickle.dumps(task))} bytes, its result {len(pickle.dumps(objective.count(AS_GIVEN)))}; the part,"
        f" {len(pickle.dumps(objective)) / 1e6:.1f} MB, goes once to each process.\n"
    )
    table(("processes", "evaluations a second", "against one"), rows)


def run() -> None:
    """All three."""
    speed()
    print()
    workers()
    print()
    methods()
