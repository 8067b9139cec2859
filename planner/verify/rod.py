"""The wire as the real one moves: a discrete elastic rod with weight, followed from the mounted state.

Clamped at both ends to full frames (x along the wire, z the section plane's normal), of fixed length.
`mount` finds the shape the wire has when it is put in; `follow` carries it through the motion of its ends.
Where the shape in hand stops being stable, the real wire snaps to another one: that instant is marked, and
the rod goes on from the shape that it falls into. No closed form is used: see `rod_energy` for the model,
`rod_path` for its order and refinement.
"""

from planner.verify.rod_follow import follow
from planner.verify.rod_model import Rod, RodError, RodPath, RodShape
from planner.verify.rod_mount import mount

__all__ = ["Rod", "RodError", "RodPath", "RodShape", "follow", "mount"]
