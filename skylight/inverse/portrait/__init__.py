"""A photographed person in another light: shading of head and bust, the photograph relit."""
