"""Any known diffuse object as a light probe (thesis, section 7.1.1)."""
