"""The door of pages that are served beyond this computer: TLS, and a token."""
