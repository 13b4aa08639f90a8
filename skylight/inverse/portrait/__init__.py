"""A photographed person in another light: shading of head, hair and bust, the photograph relit."""
