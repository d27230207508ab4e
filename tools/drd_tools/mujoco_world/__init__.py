"""A second simulation, in MuJoCo, which shares no formula with drd_tools.simulate or drd.effects."""
