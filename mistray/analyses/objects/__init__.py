"""Critical, illuminated and common objects."""
