"""The live page: the camera's picture, the phase and the inputs in a browser.

    control's process                                    the page's process
    log ─► LiveFeed ─► newest picture ─┐                ┌─► JPEG, outlines ─► each viewer's WebSocket
    state_report ────► newest state ───┴─ thread, pipe ─┘
    OrderDesk ◄──────────────────────── lines ◄──────────── buttons

What flies hands over references and goes on; the rest is done by a thread that waits in the kernel and by a
process of lower priority. Nothing is handed over while nobody looks.
"""
