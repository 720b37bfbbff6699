"""Every number that decides in this room, with what it was counted on.

Evidence is in nats: the natural logarithm of by how much readings favour one statement over another.
"""

from __future__ import annotations

import numpy as np

#: Prior scales of what a hypothesis adds to a reading, in noises: a mean over four keeps the answer within a nat of the
#: best of them from 0.5 to 30 noises.
SCALES = np.array([0.7, 2.0, 6.0, 20.0])
#: From where on something is missing: 100 to 1. Of 41 runs with nothing hidden, on all robots, none came there.
ALARM = float(np.log(100.0))
#: By how much shapes must say more than effects before the effects are doubted: 1,000 to 1.
SURE = float(np.log(1e3))
#: Up to where two sets of effects are a tie, 10,000 to 1: refits move evidence by a few nats.
TIED = float(np.log(1e4))

#: By how much a name must beat the best shapes in its place (d), and what it must tell beside all of them (t). Of 57
#: spherical runs with physics of no catalogue d = 9 let 19 innocents through, these 8, and kept half of the true names.
NEEDED, TELLS = 30.0, 5.0
#: From where on a name that is needed so much need tell nothing beside shapes: true ones had 43 to 82, innocents less.
PLAINLY = 40.0

#: Part of a column's square below which the model holds it: of an effect, and of a shape, which is no more exact.
HELD_EFFECT, HELD_SHAPE = 1e-6, 4e-4
#: Part of its own square below which a column, as it was made, is rounding: a wave read in each of its zeros.
NOTHING = 1e-10
#: Part of a shape inside one effect from which on it is that effect once more, and no rival of it.
TWIN = 0.97
#: Part of poses to rows from which on a run is looked at row by row.
FEW_VISITS = 0.8

#: Logarithm of how much louder one axis is than the mean, from which on axes are weighed anew.
UNEVEN = 0.3
