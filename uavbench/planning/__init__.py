"""Planning: searches over whole flights, for planners and for those who measure how far from the best they are."""
