"""What counts as an impact, what as resting: the numbers that both engines obey."""

# Lasting contacts hold their forces for this long [s].
CONTACT_STEP = 0.01
# An impact is the start of a lasting contact when it is slower than this [m/s], or when the bodies are
# pressed together so that even the full rebound would end within a contact step: without such a rule, bounces
# crowd without end.
LOW_SPEED = 1e-4
# Bodies this near [m] rest on each other if they close in no faster than this [m/s], and part no faster than
# pymunk, whose shapes are this much larger than they are [m], sees over a contact step. Smaller accelerations
# are rounding [m/s^2].
REST_GAP, REST_SPEED, SKIN = 1e-5, 1e-7, 1e-4
PART_SPEED = SKIN / CONTACT_STEP
REST_PRESS = 1e-9
# Impacts this close in time are solved together, so that symmetric squeezes stay symmetric [s].
SIMULTANEOUS = 1e-12
# Polygons may graze each other unseen over this much motion, and touch when they overlap by this much; all
# bodies may sink this much into what they rest on [m].
STRIDE, GRAZE, SINK = 1e-3, 1e-10, 1e-6
