"""Triangles between Cura and files: Cura has y up, prints have z up. Needs nothing but numpy.

Cura's axes (x, y, z) are (x, z, −y) of the print; both are right-handed, so triangles keep their sense.
"""

import numpy

STL_RECORD = numpy.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def to_print(points):
    """(n, 3) points of Cura's as points of the print."""
    points = numpy.asarray(points, dtype=numpy.float64)
    return numpy.column_stack((points[:, 0], -points[:, 2], points[:, 1]))


def from_print(points):
    """(n, 3) points of the print as Cura's."""
    points = numpy.asarray(points, dtype=numpy.float64)
    return numpy.column_stack((points[:, 0], points[:, 2], -points[:, 1]))


def corners(vertices, indices):
    """(m, 3, 3) corners of triangles; without indices, vertices come three by three."""
    vertices = numpy.asarray(vertices)
    if indices is None or not len(indices):
        return vertices.reshape(-1, 3, 3)
    return vertices[numpy.asarray(indices)]


def local_points(triangles, world):
    """(3 m, 3) float32 points of a node from (m, 3, 3) triangles of the print; world: the node's (4, 4) matrix."""
    points = from_print(numpy.asarray(triangles).reshape(-1, 3))
    back = numpy.linalg.inv(numpy.asarray(world, dtype=numpy.float64))
    return (numpy.column_stack((points, numpy.ones(len(points)))).dot(back.T))[:, :3].astype(numpy.float32)


def write_stl(path, triangles):
    """Binary STL of (m, 3, 3) corners in mm."""
    records = numpy.zeros(len(triangles), dtype=STL_RECORD)
    records["corners"] = triangles
    with open(path, "wb") as file:
        file.write(b"binary STL, from Cura, mm".ljust(80))
        file.write(numpy.uint32(len(records)).tobytes())
        file.write(records.tobytes())


def read_stl(path):
    """(m, 3, 3) corners of a binary STL. Raises ValueError for one that is cut short."""
    with open(path, "rb") as file:
        data = file.read()
    count = int(numpy.frombuffer(data, "<u4", 1, 80)[0]) if len(data) >= 84 else -1
    if len(data) < 84 + count * STL_RECORD.itemsize or count < 0:
        raise ValueError("the corrected model is cut short")
    return numpy.frombuffer(data, STL_RECORD, count, 84)["corners"].astype(numpy.float64)
