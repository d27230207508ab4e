"""A second simulated world, in MuJoCo: it shares no formula with drd_tools.simulate or drd.effects."""
