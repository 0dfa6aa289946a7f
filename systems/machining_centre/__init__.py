"""The machining centres: a tripod and a quadruped whose legs machine as well as walk.

Source of everything here: H. Yang, S. Krut, C. Baradat, F. Pierrot, "A new concept of
self-reconfigurable mobile machining centers".
"""
