"""Edits of the graph of channels and nodes, on the host: channels that are joined, shortened, merged and added."""
