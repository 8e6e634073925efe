target: str = "RosBlindTurttleBot"
