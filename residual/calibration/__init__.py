"""The paper's chapter: every data-driven model under every scheme of validation."""
