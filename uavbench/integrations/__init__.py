"""Adapters for other libraries, each of which is imported only where its adapter is used."""
