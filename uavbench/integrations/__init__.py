"""Adapters for other libraries. Each library is imported only by its adapter's module."""
