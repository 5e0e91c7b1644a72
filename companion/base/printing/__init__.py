"""Printed pages: paper sizes, vector pages as PDF, SVG and PNG."""
