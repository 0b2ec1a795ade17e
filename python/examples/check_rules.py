"""Check rules and print the diagnostics, as text and by their parts. Needs numpy only.

Run it as `python python/examples/check_rules.py`. It prints:

```text
faulty.dl:2:26 unknown-predicate: did you mean `IsInInter`?
faulty.dl:3:37 unbound-variable: add a positive atom that binds `Z`, such as `Sees(X, Z)`
as text:
error[unknown-predicate]: no predicate `IsInIntre` is declared
  --> faulty.dl:2:26
   |
 2 | Stop(X) :- IsAtInter(X), IsInIntre(Y).
   |                          ^^^^^^^^^
```
"""

import logicity

FAULTY = """\
.include "vocabulary.dl"
Stop(X) :- IsAtInter(X), IsInIntre(Y).
Slow(X) :- IsTiro(X), Not(NextTo(X, Z)).
"""

for diagnostic in logicity.check(FAULTY, name="faulty.dl"):
    place = diagnostic["labels"][0]
    print(f"{place['file']}:{place['line']}:{place['column']} {diagnostic['code']}: {diagnostic['help'][0]}")

try:
    logicity.Program(FAULTY, name="faulty.dl")
except logicity.InputError as error:
    print("as text:", *str(error).splitlines()[:5], sep="\n")
