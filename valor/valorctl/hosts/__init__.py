"""An instance on several computers: OpenSSH reaches them, one supervisord runs on each."""
