"""Planning: searches over whole flights, for planners and for upper bounds."""
