"""The vocabulary of array axes, used in every annotation.

    nodes      N points in scaled time tau in [0, 1];
    intervals  N - 1, between neighbouring nodes;
    states     physical states of the vehicle (13 for a rigid body);
    controls   physical controls (rotor thrusts);
    polytopes  convex cells of a corridor;
    faces      half-spaces of one polytope, padded with rows 0.x <= 1;
    rotors     columns of the thrust and torque maps.

All quantities are SI: metres, seconds, kilograms, newtons, radians.
"""

from jaxtyping import Array, Bool, Float, Int

Scalar = Float[Array, ""]
Vector3 = Float[Array, "3"]
Quaternion = Float[Array, "4"]
Flag = Bool[Array, ""]
Count = Int[Array, ""]
Nodes = Float[Array, "nodes"]
States = Float[Array, "nodes states"]
Controls = Float[Array, "nodes controls"]
Points = Float[Array, "points 3"]
Normals = Float[Array, "polytopes faces 3"]
Offsets = Float[Array, "polytopes faces"]
