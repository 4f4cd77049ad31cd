"""What the kernels of particles are handed: N worlds, and what a scene asks of them."""

# arrays are types to Warp
# pyright: reportInvalidTypeForm=false

from dataclasses import dataclass

import warp as wp

from understudy_warp_torch.shapes import Tools

#: Rows of working memory for each particle: two of positions and the weight of its constraints, 1 over
#: their number (−1: it is not there), which iterations read and write in turn, and one of where the
#: sub-step began, with λ of the fluid.
ROWS = 3
#: Particles whose working memory fits into the shared memory of a block: 45 of 48 KiB, of which Warp
#: takes one.
SHARED_PARTICLES = 960
#: Nearer than this particles have no direction from each other, m.
NEAR = wp.constant(1e-9)
#: Particles of fluids touch at this share of the sum of their radii: nearer than the density
#: constraint ever has them in a body of fluid, but where a sheet is thin it does not hold.
FLUID_CONTACT = wp.constant(0.7)


@wp.struct
class System:
    """What kernels are handed. N worlds, P particles, K slots for springs, M neighbours, Q materials."""

    # the state
    position: wp.array2d(dtype=wp.vec3)
    velocity: wp.array2d(dtype=wp.vec3)
    active: wp.array2d(dtype=float)
    contact_force: wp.array2d(dtype=wp.vec3)  # of tools, mean over the present control period, N
    spring_partner: wp.array3d(dtype=int)
    spring_length: wp.array3d(dtype=float)
    substep: wp.array(dtype=int)  # done in the present control period, (N,)
    tools: Tools
    control: wp.array2d(dtype=float)
    particles: int
    # particles and materials; what worlds may differ in is (N, …)
    radius: wp.array(dtype=float)
    inverse_mass: wp.array(dtype=float)
    material: wp.array(dtype=int)
    gravity: wp.array(dtype=wp.vec3)
    friction: wp.array2d(dtype=float)
    static_ratio: wp.array(dtype=float)  # of static to dynamic friction, (Q,)
    cohesion: wp.array2d(dtype=float)
    cohesion_range: wp.array(dtype=float)
    damping: wp.array(dtype=float)
    rest_density: wp.array(dtype=float)  # 0: no fluid
    viscosity: wp.array2d(dtype=float)
    tension: wp.array(dtype=float)
    softening: wp.array(dtype=float)  # of the density constraint, (Q,)
    # table
    sides: int  # 0: no table, 1: the table, 5: and walls
    table_friction: float
    lower: wp.vec2
    upper: wp.vec2
    # solver
    dt: float
    substeps: int
    iterations: int
    relaxation: float
    sleep: float
    reach: float
    room: int  # M
    slots: int  # K
    smoothing: float
    stiffness: float  # of springs, in an iteration
    per_iteration: float  # 1 / iterations
    # working memory
    memory: wp.array(dtype=wp.vec4)  # (N · ROWS · P,)
    neighbour: wp.array3d(dtype=int)
    neighbour_count: wp.array2d(dtype=int)
    overflow: wp.array2d(dtype=int)


@dataclass(frozen=True)
class Features:
    """What the kernels of a scene can do, known when they are compiled."""

    fluids: bool
    springs: bool
    alike: bool  #: all particles have one radius, mass and material, which is no fluid
    shared: int  #: particles that shared memory has room for; 0: working memory is not there
    threads: int  #: of a block
