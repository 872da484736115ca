"""CAD files: STEP, IGES, BREP through OpenCASCADE, `.3dm` through rhino3dm."""
