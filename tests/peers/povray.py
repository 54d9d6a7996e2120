"""Writes the spheres of a job of tests/figures/many.py for POV-Ray 3.7, as a blob, whose parts melt together, or as a sharp union:
python3 tests/peers/povray.py spheres.json blob|union > spheres.pov && povray +W960 +H540 -A -D +WT2 +Ispheres.pov +Ospheres.png
"""

import json
import sys

job = json.load(open(sys.argv[1]))
union = job["scene"]["objects"][0]["shape"]["union"]
print("""#version 3.7; global_settings { assumed_gamma 1 }
background { rgb <0.6, 0.7, 0.8> }
camera { right -x * image_width / image_height location <0.9, 1.5, -2.6> look_at 0 angle 76.7 }
light_source { <500, 750, -433> rgb 1 }""")
blob = sys.argv[2] == "blob"
print("blob { threshold 0.5" if blob else "union {")
for shape in union["of"]:
    moved = shape["translate"]
    radius = moved["child"]["sphere"]["radius"]
    place = "<{}, {}, {}>".format(*moved["by"])
    # (1 - (d / R)^2)^2 = 0.5 at the sphere's radius
    print(f"sphere {{ {place}, {radius / 0.5412} 1 }}" if blob else f"sphere {{ {place}, {radius} }}")
print("pigment { rgb 0.8 } finish { ambient 0.1 diffuse 0.7 } }")
