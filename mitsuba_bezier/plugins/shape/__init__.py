"""The shape `beziertriangle`: parameters, attributes, silhouettes."""
