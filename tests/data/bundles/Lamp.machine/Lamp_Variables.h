//
// Lamp_Variables.h
//
// Automatically created through MiCASE -- do not change manually!
//
int	count;	///< times switched on
int	limit = 3;	///<
bool	broken;	///< whether it is
Status_t	lamp_status;	///< what the lamp says
