"""What the owner of a daemon may do meanwhile: `nserver ctl`.

control            every command        control_socket     where they are said; control_options: by the command line
"""
