"""What the kernels of cloth are handed: N worlds, and what a scene asks of them."""

# arrays are types to Warp
# pyright: reportInvalidTypeForm=false

from dataclasses import dataclass

import warp as wp

from understudy_warp_torch.shapes import Tools

#: Shapes that a scene may have: bits of a number.
MOST_SHAPES = 31
#: Nearer than this points have no direction from each other, m.
NEAR = wp.constant(1e-9)


@wp.struct
class Cloth:
    """What kernels are handed. N worlds, V vertices, F triangles, K colours of edges and L of hinges, M
    candidates, U vertices of grips. Arrays of vertices are (N · V,)."""

    # the state
    position: wp.array(dtype=wp.vec3)
    velocity: wp.array(dtype=wp.vec3)
    force: wp.array(dtype=wp.vec3)
    side: wp.array(dtype=float)
    anchor: wp.array(dtype=wp.vec3)  # positions when what may touch was last searched
    # bits of the shapes that were near then: of a triangle, or ~bits while it touches one, (N, F); of a
    # vertex ~bits, or 0 if none is near a triangle of it
    face_near: wp.array2d(dtype=int)
    near: wp.array(dtype=int)
    substep: wp.array(dtype=int)  # done in the present control period, (N,)
    closed: wp.array2d(dtype=float)  # (N, G)
    holder: wp.array2d(dtype=int)  # the grip that holds, −1: none, (N, U)
    held_at: wp.array2d(dtype=wp.vec3)  # in the frame of the grip's tool, (N, U)
    tools: Tools
    control: wp.array2d(dtype=float)
    # the mesh
    vertices: int
    faces: int
    pair: wp.array(dtype=wp.vec2i)
    rest: wp.array(dtype=float)
    unit: wp.array(dtype=float)
    first: wp.array(dtype=int)  # (K + 1,)
    kind: wp.array(dtype=int)  # (K,)
    colours: int  # K
    quad: wp.array(dtype=wp.vec4i)
    quad_weight: wp.array(dtype=wp.vec4)
    quad_unit: wp.array(dtype=float)
    quad_first: wp.array(dtype=int)  # (L + 1,)
    quad_colours: int  # L
    inverse_area: wp.array(dtype=float)  # 1/m², 0: pinned
    face: wp.array(dtype=wp.vec3i)
    corner_start: wp.array(dtype=int)  # (V + 1,)
    corner: wp.array(dtype=int)  # (3 F,)
    grips: int
    grip_vertices: int  # U
    grip_tool: wp.array(dtype=int)
    grip_vertex: wp.array(dtype=int)
    grip_holds: wp.array2d(dtype=int)  # (U, G)
    # worlds may differ in these
    gravity: wp.array(dtype=wp.vec3)
    friction: wp.array(dtype=float)
    density: wp.array(dtype=float)
    stiffness: wp.array2d(dtype=float)  # (N, 3)
    # the fabric
    damping: float
    gap: float
    # self-contact
    thickness: float
    room: int  # M
    buckets: int  # a power of 2
    apart_start: wp.array(dtype=int)
    apart: wp.array(dtype=int)
    # solver
    dt: float
    substeps: int
    every: int  # sub-steps between searches
    bending_every: int  # sub-steps from one sweep over hinges to the next
    # working memory
    weight: wp.array(dtype=float)  # 1 / area, 0: held or pinned
    start: wp.array(dtype=wp.vec3)
    way: wp.array2d(dtype=float)  # how far a shape may go until the next search, (N, S)
    middle: wp.array2d(dtype=wp.vec3)  # of the sphere around a shape at the search, (N, S)
    corner_push: wp.array(dtype=wp.vec4)  # and its weight, (N · 3 F,)
    corner_shift: wp.array(dtype=wp.vec3)
    head: wp.array(dtype=int)  # (N · buckets,)
    next: wp.array(dtype=int)
    candidate: wp.array3d(dtype=int)  # (N, V, M)
    candidates: wp.array(dtype=int)
    crowd: wp.array(dtype=float)  # 1 / layers that touch
    push: wp.array(dtype=wp.vec3)
    shift: wp.array(dtype=wp.vec3)
    left_out: wp.array(dtype=int)  # candidates for which there was no room, so far


@dataclass(frozen=True)
class Features:
    """What the kernels of a scene can do, known when they are compiled."""

    shapes: bool
    grips: bool
    self_contact: bool
    shared: int  #: vertices that shared memory has room for; 0: positions are not there
    weighted: bool  #: whether weights are beside them there
    threads: int  #: of a block
