"""See a run and measure in it, in a browser.

| module | what it holds |
|---|---|
| `contents` | what a run has to show so far, and what is missing, in words |
| `engine` | what is seen from a camera: colours, temperatures, depth |
| `picture` | palettes, ranges, isotherms, layouts: what is seen as a picture |
| `probe` | what is known about one pixel |
| `ruler` | lengths, areas and heights with their intervals |
| `scale_check` | the edges of both modalities at a scale that is tried |
| `guard` | the web server: one machine, no strangers, no tunnel |
| `session`, `panels` | one browser: its camera, its pictures, its controls |
| `start` | `rtgs view` and `rtgs.view` |

Only `guard`, `session`, `panels` and `start` know viser.
"""
