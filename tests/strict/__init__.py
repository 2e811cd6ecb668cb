"""Readers as strict as the original tools, written from the rules of the formats and from no reader of mdm."""
