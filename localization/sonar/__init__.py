"""What sonars read in a map of walls, and which readings may correct a belief.

measurement, range_noise, gating    exact rays; single_beam, ring_code: the same, quicker
cone > reflectors                   all that a real sonar's cone may hear; single_cone: the same, quicker
aim                                 where a sonar looks, by what it hears at all
"""
