"""Run the expert city until a car stops, and print why. Needs numpy only.

Run it as `python python/examples/why_stop.py`. It prints:

```text
tick 1: Car_1 at [82, 94], heading Right: Stop

Stop("Car_1")  by S6: an ambulance waits for the old on its right  [transfer-medium.dl:14]
├─ IsAmbulance("Car_1")
├─ RightOf("Pedestrian_6", "Car_1")
├─ IsOld("Pedestrian_6")
└─ in view: Sees("Car_1", "Pedestrian_6")

```
"""

from logicity import ACTIONS, Simulation

city = Simulation("expert", split="test", seed=4)
stop = ACTIONS.index("Stop")
cars = [number for number, agent in enumerate(city.agents) if agent.name.startswith("Car")]
for _ in range(100):
    tick = city.tick()
    stopped = [car for car in cars if tick.action[car] == stop]
    if stopped:
        print(city.explain(city.agents[stopped[0]].name))
        break
