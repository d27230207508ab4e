"""How errors grow along the path: a linear model around it, and the filter that whitens data and sensitivities."""
