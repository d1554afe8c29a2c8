"""An arm of one joint as a URDF, of whose parts some may be replaced, and a mesh for it."""

import struct

import numpy as np

INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.2
LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="9"/>'


def arm(
    inertia=INERTIA,
    placed="",
    origin='<origin xyz="0 0 1"/>',
    shape='<sphere radius=".1"/>',
    axis="",
    mass="1",
    more="",
):
    return (
        f'<robot name="small"><link name="base"/><link name="upper"><inertial>{placed}<mass value="{mass}"/>{inertia}'
        f"</inertial><collision><geometry>{shape}</geometry></collision></link>"
        f'<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>{origin}{axis}{LIMIT}'
        f"</joint>{more}</robot>"
    )


def stl(corners, faces=((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))):
    triangles = [struct.pack("<12fH", 0, 0, 0, *np.ravel([corners[i] for i in face]), 0) for face in faces]
    return b" " * 80 + struct.pack("<I", len(triangles)) + b"".join(triangles)


def mesh(name):
    return f'<mesh filename="{name}"/>'
