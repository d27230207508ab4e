"""Find the physics that a nominal model leaves out, name it, model it, and show that it holds."""
