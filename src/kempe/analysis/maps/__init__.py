"""Long work in parts: what is done is kept on disk, in threads or on a cluster; and verbs over
files of any size.
"""
