"""Make a scene around models: camera, light, ground, materials, and which parts are seen."""
