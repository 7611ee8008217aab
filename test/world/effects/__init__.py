"""Effects that a record can hide, in functional forms that are not those of the catalogue.

`development_forms`, `second_forms` and `earlier_forms`, which scored the blind runs up to 2026-11-23, may be looked at
and run while a tracer is built, and its model is learned from them. `third_forms` are for scoring only: do not read,
import or run them while a tracer is built. Every class of the catalogue has at least one form in each. `draw`
reaches any by the name of its split, so that nobody has to open the module.

`sitting.drawn(count, seed, split, ...)` draws people with something hidden in them and moves them; a sitting writes
bags, gives the streams with and without what is hidden, and says the truth, which is in neither.

`mixture` has the kinds of background: the paper's (`background`), and mechanisms in the body (`body_mechanisms`) and in
the sensors (`sensor_mechanisms`). Those of `unseen_mechanisms` are for scoring only, as `third_forms` are: nothing is
trained or adjusted on them.
"""
