"""Every number that decides in more than one place, with what it was counted on.

Evidence is in nats: the natural logarithm of by how much readings favour one statement over another.
"""

from __future__ import annotations

import numpy as np

# -- Evidence ----------------------------------------------------------------------------------------------------------

#: Prior scales of what a hypothesis adds to a reading, in noises: a mean over four keeps the answer within a nat of the
#: best of them from 0.5 to 30 noises.
SCALES = np.array([0.7, 2.0, 6.0, 20.0])
#: From where on something is missing: 100 to 1. Of 41 runs with nothing hidden, on all robots, none came there.
ALARM = float(np.log(100.0))
#: Up to where nothing more is seen, 20 to 1; a name must have grown by so much to be confirmed.
LEFT = float(np.log(20.0))
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
#: Part of a square inside something else from which on it is that once more: a shape in an effect, an effect in what is
#: fitted, a direction in a pose.
TWIN = 0.97
#: Part of poses to rows from which on a run is looked at row by row.
FEW_VISITS = 0.8

#: Logarithm of how much louder one axis is than the mean, from which on axes are weighed anew.
UNEVEN = 0.3

#: Plausible sizes up to which people are told that a parameter is plausible; and up to which a search takes it for as
#: good as any.
TOLD, PLAUSIBLE = 3.0, 5.0

# -- Chance ------------------------------------------------------------------------------------------------------------

#: Level of a test, unless one is given, and the power that is asked of it.
LEVEL, POWER = 0.01, 0.8
#: How often is nearly always.
NEARLY_ALWAYS = 0.95
#: Chance that accidents are taken for something; of what is hardly one; and of what is none.
ACCIDENT, HARDLY, NEVER = 0.005, 1e-3, 1e-6
#: Deviations from which on something is seen, from which on it is sure, and from which on a row is wrong.
SEEN_SIGMA, SURE_SIGMA, FAR_SIGMA = 2.0, 3.0, 7.0
#: What is so many times as loud as noise is more than noise.
LOUDER = 1.25
#: Part of the rows that may be wrong before the rest is no run any more.
WRONG = 0.2

# -- Numbers -----------------------------------------------------------------------------------------------------------

#: Part of a number that is rounding; and of one that is a difference.
ROUNDING, DIFFERENCES = 1e-9, 1e-7
#: Part of a range within which places are one.
SAME_PLACE = 1e-4
#: Part of a range over which something moves.
MOVES = 0.05
#: Rounds after which what has not come to rest is left as it is.
ROUNDS = 20
#: Most shapes of a description.
MOST = 10
#: How many are a few: sets that are looked at together, things of a list, rows of a stretch.
A_FEW = 6
