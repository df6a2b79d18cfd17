"""`semscape app`: micrographs in, surface out, in a page of this machine's own browser.

Runs are the run folders on disk; what the app adds to them can be deleted without losing a result. The queue, the
workspace and the edits know nothing of HTTP; `semscape.app.server` puts them behind it.
"""
